// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace sutured::scene {

/// One thing wrong with a scene, and where. Line and column count from 1; 0 where there is none.
struct SceneFault {
  std::string file;
  int line = 0;
  int column = 0;
  std::string what;
  std::string mend;
};

/// A scene that cannot be simulated. `what()` has one line per fault,
/// `file[:line:column]: what; mend`.
class SceneError : public std::runtime_error {
 public:
  explicit SceneError(std::vector<SceneFault> faults)
      : std::runtime_error(text(faults)), faults_(std::move(faults)) {}

  [[nodiscard]] const std::vector<SceneFault>& faults() const noexcept { return faults_; }

 private:
  static std::string text(const std::vector<SceneFault>& faults) {
    std::string text;
    for (const SceneFault& fault : faults) {
      if (!text.empty()) text += '\n';
      text += fault.file;
      if (fault.line > 0) text += ':' + std::to_string(fault.line);
      if (fault.column > 0) text += ':' + std::to_string(fault.column);
      text += ": " + fault.what;
      if (!fault.mend.empty()) text += "; " + fault.mend;
    }
    return text;
  }
  std::vector<SceneFault> faults_;
};

}  // namespace sutured::scene
