// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

namespace sutured::commands {

/// A text file that is complete or an exception.
class OutputFile {
 public:
  OutputFile(const std::filesystem::path& directory, const std::string& name)
      : path_(directory / name), stream_(path_) {
    if (!stream_)
      throw std::runtime_error(path_.string() + ": cannot be written; choose another --out");
    stream_.precision(17);
  }
  template <typename T>
  OutputFile& operator<<(const T& value) {
    stream_ << value;
    return *this;
  }
  void close() {
    stream_.close();
    if (!stream_)
      throw std::runtime_error(path_.string() + ": not written completely; is the disk full?");
  }

 private:
  std::filesystem::path path_;
  std::ofstream stream_;
};

}  // namespace sutured::commands
