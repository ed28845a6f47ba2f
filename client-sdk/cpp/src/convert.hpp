// SPDX-License-Identifier: Apache-2.0
// From wire types to the SDK's and back.
#pragma once

#include "protocol/types.hpp"
#include "suture/session.hpp"
#include "suture/types.hpp"

namespace suture {

[[nodiscard]] ForceState force_state(v1::ToolState state) noexcept;
[[nodiscard]] Status to_status(const v1::ServerStatus& wire);
[[nodiscard]] Event to_event(const v1::Event& wire);
[[nodiscard]] MeshTopology to_topology(const v1::MeshTopology& wire);
[[nodiscard]] MeshFrame to_frame(const v1::MeshFrame& wire);
[[nodiscard]] ToolView to_tool(const v1::ToolView& wire);
[[nodiscard]] NeedleView to_needle(const v1::NeedleState& wire);
[[nodiscard]] ThreadView to_thread(const v1::ThreadState& wire);
[[nodiscard]] ContactsView to_contacts(const v1::ContactState& wire);
[[nodiscard]] QualityView to_quality(const v1::Quality& wire);
[[nodiscard]] v1::CommandKind to_wire(CommandKind kind) noexcept;

template <std::size_t N>
std::array<double, N> array_of(const double (&wire)[N]) noexcept {
  std::array<double, N> values;
  std::memcpy(values.data(), wire, sizeof wire);
  return values;
}

}  // namespace suture
