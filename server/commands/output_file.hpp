// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <system_error>

namespace sutured::commands {

/// An --out that cannot be used: `what()` says why, and the mend.
struct OutputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Makes the folder that --out names; throws OutputError.
inline void make_output_folder(const std::string& folder) {
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  if (failed)
    throw OutputError(folder + ": cannot be made: " + failed.message() + "; choose another --out");
}

/// A text file that is complete or an exception.
class OutputFile {
 public:
  OutputFile(const std::filesystem::path& directory, const std::string& name)
      : path_(directory / name), stream_(path_) {
    begin();
  }
  /// Goes on with a file of at least `size` bytes behind its first `size`; `drop_rest` drops the
  /// rest, once all files of a run are known to be good.
  OutputFile(const std::filesystem::path& directory, const std::string& name, std::uint64_t size)
      : path_(directory / name) {
    std::error_code failed;
    const std::uint64_t present = std::filesystem::file_size(path_, failed);
    if (failed || present < size)
      throw std::runtime_error(path_.string() +
                               ": is not what the checkpoint's run had written; give --out the "
                               "folder of that run");
    stream_.open(path_, std::ios::app | std::ios::ate);
    begin();
  }
  void drop_rest(std::uint64_t size) {
    std::error_code failed;
    std::filesystem::resize_file(path_, size, failed);
    stream_.seekp(0, std::ios::end);
    if (failed) stream_.setstate(std::ios::failbit);
    begin();
  }
  template <typename T>
  OutputFile& operator<<(const T& value) {
    stream_ << value;
    return *this;
  }
  /// Returns how long the file is now.
  [[nodiscard]] std::uint64_t size() { return static_cast<std::uint64_t>(stream_.tellp()); }
  void close() {
    stream_.close();
    if (!stream_)
      throw std::runtime_error(path_.string() + ": not written completely; is the disk full?");
  }

 private:
  void begin() {
    if (!stream_)
      throw std::runtime_error(path_.string() + ": cannot be written; choose another --out");
    stream_.precision(17);
  }
  std::filesystem::path path_;
  std::ofstream stream_;
};

}  // namespace sutured::commands
