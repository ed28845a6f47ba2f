// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "scene/scene.hpp"
#include "scene/scene_error.hpp"

namespace sutured::scene {

/// Reads a scene file and the meshes beside it, and checks that it can be simulated.
///
/// Mesh paths are relative to the scene's folder. Throws SceneError with every fault found in one
/// pass: the file itself, TOML syntax, unknown keys, wrong types, numbers out of range, names,
/// meshes, groups, and bodies that nothing holds. `Scene::notes` says what is legal but worth
/// knowing. The keys are described in docs/guide/scene-file.md.
[[nodiscard]] Scene read_scene(const std::string& path);

/// Reads a scene from `text` as if it stood in a file at `path`.
[[nodiscard]] Scene parse_scene(const std::string& text, const std::string& path);

}  // namespace sutured::scene
