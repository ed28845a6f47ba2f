// SPDX-License-Identifier: Apache-2.0
// The IDL files as text: schemas of encoding `omgidl` for recordings and web clients.
#pragma once

#include <string_view>

namespace suture {

/// idl/suture_v1.idl, the contract.
[[nodiscard]] std::string_view suture_v1_idl() noexcept;
/// idl/foxglove_scene.idl.
[[nodiscard]] std::string_view foxglove_scene_idl() noexcept;

}  // namespace suture
