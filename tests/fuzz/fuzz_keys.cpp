// SPDX-License-Identifier: GPL-3.0-or-later
// Folders of keys, and a site's register; the first byte chooses:
//
//     0 … 5   one file of a good identity, in the order of kFiles, is the rest of the bytes
//     s       a file of it is spliced: its number, where (two bytes), how many bytes go, what comes
//     p       permissions, signed by the site's authority as if it had written them
//     r       register.json of a site
//
// The site is made anew by each process: no private key stands in the repository.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "keys/authority.hpp"
#include "keys/site.hpp"
#include "protocol/security.hpp"
#include "support/temporary_folder.hpp"
#include "suture/error.hpp"

namespace {

using namespace suture;
namespace fs = std::filesystem;
using sutured::testing::read_file;

constexpr const char* kFiles[] = {key_files::kAuthority,   key_files::kCertificate,
                                  key_files::kKey,         key_files::kGovernance,
                                  key_files::kPermissions, key_files::kRevoked};
constexpr std::int64_t kDay_s = 86400;

void write(const fs::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

/// A site with one identity, and the folder of that, which each input changes and mends again.
class World {
 public:
  World() {
    keys::Site::create(site_, "ward 7", 30, keys::Protection::kEncryptWithOrigin);
    folder_ = keys::Site(site_).add("left", {{keys::Role::kDevice}, {"driver"}, -1, ""}, kDay_s);
    expires_s_ = read_identity(folder_).expires_s;
    authority_ = {read_file(site_ / "authority.key.pem"), read_file(site_ / key_files::kAuthority)};
  }

  /// Who the identity is with `bytes` in that file.
  void read_with(const char* name, const std::string& bytes, bool ours) {
    const std::string good = read_file(folder_ / name);
    write(folder_ / name, bytes);
    try {
      const Identity identity = read_identity(folder_);
      // Whoever changes a folder gains nothing by it.
      if (identity.name != "left" || identity.expires_s > expires_s_) std::abort();
      if (!ours && identity.tools != std::vector<std::string>{"driver"}) std::abort();
      for (const std::string& tool : identity.tools)
        if (!identity.may_drive(tool)) std::abort();
    } catch (const Error& error) {
      if (error.code() != ErrorCode::kPermissionDenied || error.mend().empty()) std::abort();
    }
    write(folder_ / name, good);
  }
  void splice(const char* name, std::size_t at, std::size_t gone, const std::string& come) {
    std::string bytes = read_file(folder_ / name);
    at %= bytes.size();
    read_with(name, bytes.replace(at, std::min(gone, bytes.size() - at), come), false);
  }
  void read_permissions(const std::string& text) {
    read_with(key_files::kPermissions, keys::sign(authority_, text), true);
  }
  void read_register(const std::string& text) {
    const std::string good = read_file(site_ / "register.json");
    write(site_ / "register.json", text);
    try {
      const keys::Site site(site_);
      for (const keys::Entry& entry : site.entries()) {
        if (site.folder_of(entry.name).parent_path() != site_ / "identities") std::abort();
        (void)date_text(entry.expires_s);
      }
    } catch (const Error& error) {
      if (error.mend().empty()) std::abort();
    }
    write(site_ / "register.json", good);
  }

 private:
  sutured::testing::TemporaryFolder all_;
  fs::path site_ = all_.path("site"), folder_;
  std::int64_t expires_s_ = 0;
  keys::KeyPair authority_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static World world;
  if (size == 0) return 0;
  const std::string rest(reinterpret_cast<const char*>(data) + 1, size - 1);
  if (data[0] >= '0' && data[0] < '0' + std::size(kFiles))
    world.read_with(kFiles[data[0] - '0'], rest, false);
  if (data[0] == 's' && size >= 5)
    world.splice(kFiles[data[1] % std::size(kFiles)],
                 static_cast<std::size_t>(data[2]) << 8U | data[3], data[4], rest.substr(4));
  if (data[0] == 'p') world.read_permissions(rest);
  if (data[0] == 'r') world.read_register(rest);
  return 0;
}
