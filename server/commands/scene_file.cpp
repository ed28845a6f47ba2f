// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/scene_file.hpp"

#include <array>
#include <filesystem>
#include <set>

#include "suture/error.hpp"

namespace sutured::commands {
namespace {

namespace fs = std::filesystem;

// Where scenes have names, the site's own first.
std::array<fs::path, 2> scene_folders() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  return {"/etc/sutured/scenes", program.parent_path().parent_path() / "share/sutured/scenes"};
}

}  // namespace

std::string scene_file(const std::string& scene) {
  std::error_code error;
  if (scene.find('/') != std::string::npos || fs::path(scene).has_extension() ||
      fs::is_regular_file(scene, error))
    return scene;
  std::set<std::string> names;
  std::string places;
  for (const fs::path& folder : scene_folders()) {
    const fs::path file = folder / scene / "scene.toml";
    if (fs::is_regular_file(file, error)) return file.string();
    places += (places.empty() ? "" : " and ") + folder.string();
    for (const auto& entry : fs::directory_iterator(folder, error))
      if (fs::is_regular_file(entry.path() / "scene.toml", error))
        names.insert(entry.path().filename().string());
  }
  std::string known;
  for (const std::string& name : names) known += (known.empty() ? "; there are " : ", ") + name;
  throw suture::Error(
      suture::ErrorCode::kBadInput, "there is no scene \"" + scene + "\" in " + places + known,
      "give the path of a scene's file, or put the scene into /etc/sutured/scenes/" + scene +
          "/scene.toml");
}

}  // namespace sutured::commands
