// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/site.hpp"

#include <array>
#include <boost/crc.hpp>
#include <cstdio>
#include <utility>

#include "geometry/regular_file.hpp"

namespace sutured::gateway {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kFileMax = 16U << 20U;

constexpr std::array<std::pair<std::string_view, std::string_view>, 10> kTypes{{
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".svg", "image/svg+xml"},
    {".png", "image/png"},
    {".ico", "image/x-icon"},
    {".json", "application/json"},
    {".webmanifest", "application/manifest+json"},
    {".woff2", "font/woff2"},
    {".txt", "text/plain; charset=utf-8"},
}};

std::string content_type_of(const fs::path& path) {
  const std::string extension = path.extension().string();
  for (const auto& [ending, type] : kTypes)
    if (extension == ending) return std::string(type);
  return "application/octet-stream";
}

// Null where there is no such file.
std::shared_ptr<const std::string> contents(const fs::path& path) {
  try {
    return std::make_shared<const std::string>(
        geometry::read_regular_file(path.string(), kFileMax));
  } catch (const geometry::FileError&) {
    return {};
  }
}

std::string etag_of(const std::string& bytes) {
  boost::crc_32_type crc;
  crc.process_bytes(bytes.data(), bytes.size());
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "\"%08x-%zx\"", static_cast<unsigned>(crc.checksum()),
                bytes.size());
  return text.data();
}

}  // namespace

Site::Site(const fs::path& folder) : folder_(folder.string()) {
  std::error_code error;
  for (fs::recursive_directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    const fs::path& path = entry->path();
    if (path.extension() == ".gz") continue;
    File file;
    file.plain = contents(path);
    if (!file.plain) continue;
    file.gzip = contents(path.string() + ".gz");
    file.content_type = content_type_of(path);
    file.etag = etag_of(*file.plain);
    files_.emplace("/" + path.lexically_relative(folder).generic_string(), std::move(file));
  }
}

Reply Site::get(const Request& request) const {
  const auto found = files_.find(request.path == "/" ? std::string_view("/index.html")
                                                     : std::string_view(request.path));
  if (found == files_.end()) {
    if (files_.empty() && request.path == "/")
      return plain_reply(404, "the page was not built: `make viewer` puts it into " + folder_);
    return plain_reply(404, "there is no such page");
  }
  const File& file = found->second;
  Reply reply;
  reply.content_type = file.content_type;
  reply.etag = file.etag;
  reply.immutable = found->first.starts_with("/assets/");  // their names hold their hash
  if (request.if_none_match == file.etag) {
    reply.status = 304;
    return reply;
  }
  reply.gzip = request.accepts_gzip && file.gzip;
  reply.body = reply.gzip ? file.gzip : file.plain;
  return reply;
}

fs::path page_folder() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  const fs::path installed = program.parent_path().parent_path() / "share/sutured/viewer";
  if (fs::exists(installed / "index.html", error)) return installed;
  // build/PRESET/server/sutured, and build/viewer
  return program.parent_path().parent_path().parent_path() / "viewer";
}

}  // namespace sutured::gateway
