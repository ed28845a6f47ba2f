// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

namespace sutured::commands {

/// Returns the file of a scene that a command was given: a path as it is; a plain name, as
/// `anastomosis`, stands for NAME/scene.toml below /etc/sutured/scenes or, if it is not there,
/// among the scenes that came with the program.
///
/// Throws suture::Error kBadInput where a name is that of no scene.
[[nodiscard]] std::string scene_file(const std::string& scene);

}  // namespace sutured::commands
