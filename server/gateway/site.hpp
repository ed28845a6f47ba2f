// SPDX-License-Identifier: GPL-3.0-or-later
// The files of the web page, kept in memory.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "gateway/web_server.hpp"

namespace sutured::gateway {

/// Reads a folder once; a request then finds a name in a table and touches no file, so
/// that no path leads out of it. `x.gz` is what is sent of `x` to who accepts it.
/// Threads: any, after construction.
class Site {
 public:
  /// `folder` need not exist: then every request is told where the page would be.
  explicit Site(const std::filesystem::path& folder);

  [[nodiscard]] Reply get(const Request& request) const;
  [[nodiscard]] bool empty() const noexcept { return files_.empty(); }

 private:
  struct File {
    std::shared_ptr<const std::string> plain, gzip;
    std::string content_type, etag;
  };
  std::map<std::string, File, std::less<>> files_;  // by path, `/index.html`
  std::string folder_;
};

/// Returns where the page lies beside the running program: below `share` where it is
/// installed, in the build folder where it is not.
[[nodiscard]] std::filesystem::path page_folder();

}  // namespace sutured::gateway
