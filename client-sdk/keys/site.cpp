// SPDX-License-Identifier: Apache-2.0
#include "keys/site.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <span>
#include <sstream>
#include <system_error>
#include <utility>

#include "keys/authority.hpp"
#include "keys/documents.hpp"
#include "protocol/security.hpp"
#include "protocol/whole_file.hpp"
#include "suture/error.hpp"

namespace suture::keys {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRegister = "register.json";
constexpr const char* kAuthorityKey = "authority.key.pem";
constexpr const char* kIdentities = "identities";

constexpr std::array<std::pair<Role, const char*>, 5> kRoles{{{Role::kServer, "server"},
                                                              {Role::kDevice, "device"},
                                                              {Role::kViewer, "viewer"},
                                                              {Role::kRecorder, "recorder"},
                                                              {Role::kOperator, "operator"}}};

[[noreturn]] void refuse(const std::string& cause, const std::string& mend) {
  throw Error(ErrorCode::kBadInput, cause, mend);
}

constexpr const char* kWriteMend =
    "see whether this user may write there, and whether the disk is full";

[[noreturn]] void cannot(const std::string& what, const fs::path& path) {
  throw Error(ErrorCode::kPermissionDenied,
              what + " " + path.string() + " failed: " + std::strerror(errno), kWriteMend);
}

void make_folder(const fs::path& path) {
  if (::mkdir(path.c_str(), 0700) != 0) cannot("making", path);
}

void write_file(const fs::path& path, const std::string& text, mode_t mode) try {
  WholeFile file(path, mode);
  file.write(std::as_bytes(std::span(text)));
  file.commit();
} catch (const std::system_error& error) {
  throw Error(ErrorCode::kPermissionDenied, error.what(), kWriteMend);
}

std::string read_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) cannot("reading", path);
  return text.str();
}

KeyPair authority_of(const fs::path& folder) {
  const fs::path key = folder / kAuthorityKey;
  struct stat facts {};
  if (::stat(key.c_str(), &facts) != 0) cannot("reading", key);
  if ((facts.st_mode & 077) != 0)
    throw Error(
        ErrorCode::kPermissionDenied, "the authority's key " + key.string() + " is open to others",
        "where others may have read it, make a new site; else `chmod 600 " + key.string() + "`");
  return {read_file(key), read_file(folder / key_files::kAuthority)};
}

void check_name(const std::string& name) {
  constexpr const char* kLetters =
      "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.";
  if (name.empty() || name.size() > 48 || name.front() == '.' ||
      name.find_first_not_of(kLetters) != std::string::npos)
    refuse("\"" + name + "\" names no identity",
           "take 1 to 48 letters, digits, '-', '_' and '.', not a '.' first");
}

void check(const Rights& rights) {
  const auto has = [&](Role role) {
    return std::find(rights.roles.begin(), rights.roles.end(), role) != rights.roles.end();
  };
  if (rights.roles.empty()) refuse("an identity without a role may do nothing", "give --role");
  if (has(Role::kDevice) && rights.tools.empty())
    refuse("a device without a tool may drive none",
           "give --tool NAME, as in the scene, once for each");
  if (!has(Role::kDevice) && !rights.tools.empty())
    refuse("only a device drives tools", "leave out --tool, or give --role device");
  for (const std::string& tool : rights.tools)
    if (tool.empty() || tool.size() > 32 || tool.find_first_of("*?[]\\,@") != std::string::npos)
      refuse("\"" + tool + "\" names no tool", "take the name of a tool in the scene");
  if (rights.domain >= 0 &&
      (rights.domain % 2 != 0 || rights.domain > static_cast<int>(kSecuredDomains) - 2))
    refuse("domain " + std::to_string(rights.domain) + " is not usable",
           "take an even number from 0 to " + std::to_string(kSecuredDomains - 2));
  if (rights.session.size() > 64 || rights.session.find_first_of("*?[]\\,@") != std::string::npos)
    refuse("\"" + rights.session + "\" names no session",
           "take up to 64 characters without * ? [ ] \\ @ or a comma");
}

nlohmann::json json_of(const Entry& entry) {
  nlohmann::json roles = nlohmann::json::array();
  for (const Role role : entry.rights.roles) roles.push_back(name_of(role));
  return {{"name", entry.name},
          {"roles", roles},
          {"tools", entry.rights.tools},
          {"domain", entry.rights.domain},
          {"session", entry.rights.session},
          {"expires_s", entry.expires_s},
          {"serials", entry.serials},
          {"withdrawn_serials", entry.withdrawn_serials},
          {"revoked", entry.revoked}};
}

Entry entry_of(const nlohmann::json& json) {
  Entry entry;
  entry.name = json.at("name");
  for (const std::string role : json.at("roles")) entry.rights.roles.push_back(role_of(role));
  entry.rights.tools = json.at("tools");
  entry.rights.domain = json.at("domain");
  entry.rights.session = json.at("session");
  entry.expires_s = json.at("expires_s");
  entry.serials = json.at("serials");
  // Registers of before there were any have none.
  entry.withdrawn_serials = json.value("withdrawn_serials", std::vector<std::string>());
  entry.revoked = json.at("revoked");
  check_name(entry.name);
  return entry;
}

std::vector<std::string> revoked_serials(const std::vector<Entry>& entries) {
  std::vector<std::string> serials;
  for (const Entry& entry : entries) {
    const std::vector<std::string>& which = entry.revoked ? entry.serials : entry.withdrawn_serials;
    serials.insert(serials.end(), which.begin(), which.end());
  }
  return serials;
}

// A folder of our own beside `place`, to be filled and put there; else it goes again. Its name is
// new, and no identity's: those do not begin with a '.'.
class FolderBeside {
 public:
  explicit FolderBeside(fs::path place) : place_(std::move(place)) {
    std::string name = place_.parent_path() / ("." + place_.filename().string() + ".XXXXXX");
    if (::mkdtemp(name.data()) == nullptr) cannot("making", place_);
    made_ = name;
  }
  ~FolderBeside() {
    std::error_code ignored;
    if (!made_.empty()) fs::remove_all(made_, ignored);
  }
  FolderBeside(const FolderBeside&) = delete;
  FolderBeside& operator=(const FolderBeside&) = delete;

  [[nodiscard]] fs::path operator/(const char* file) const { return made_ / file; }
  // Puts it in the place of nothing, or of an empty folder.
  void put_in_place() {
    if (::rename(made_.c_str(), place_.c_str()) != 0) cannot("putting in place", place_);
    made_.clear();
  }
  // Puts it in the place of what is there, at once, which then goes.
  void replace() {
    if (!fs::exists(place_)) return put_in_place();
    if (::renameat2(AT_FDCWD, made_.c_str(), AT_FDCWD, place_.c_str(), RENAME_EXCHANGE) != 0)
      cannot("putting in place", place_);
  }

 private:
  fs::path place_, made_;
};

}  // namespace

Role role_of(std::string_view name) {
  for (const auto& [role, its_name] : kRoles)
    if (name == its_name) return role;
  refuse("\"" + std::string(name) + "\" is no role",
         "take server, device, viewer, recorder or operator");
}

const char* name_of(Role role) noexcept {
  for (const auto& [known, name] : kRoles)
    if (known == role) return name;
  return "unknown";
}

void Site::create(const fs::path& folder, const std::string& title, int days,
                  Protection protection) {
  if (title.empty() || title.size() > 40 ||
      title.find_first_of(",/|=+\"\\<>;#&") != std::string::npos)
    refuse("\"" + title + "\" names no site", "take 1 to 40 letters, digits, spaces, '-' and '_'");
  if (fs::exists(folder) && (!fs::is_directory(folder) || !fs::is_empty(folder)))
    refuse(folder.string() + " exists and is not empty", "name a new folder for the site");
  fs::path place = fs::weakly_canonical(folder);
  if (!place.has_filename()) place = place.parent_path();  // of "name/"
  const std::int64_t now = std::time(nullptr);
  const KeyPair authority = make_authority(title, now, days);
  FolderBeside made(place);
  make_folder(made / kIdentities);
  write_file(made / kAuthorityKey, authority.key, 0600);
  write_file(made / key_files::kAuthority, authority.certificate, 0644);
  write_file(made / key_files::kGovernance, sign(authority, governance_xml(protection)), 0644);
  write_file(made / key_files::kRevoked, revocation_list(authority, {}, now), 0644);
  write_file(made / kRegister, "[]\n", 0600);
  made.put_in_place();
}

Site::Site(const fs::path& folder) : folder_(folder) {
  if (!fs::exists(folder_ / kRegister))
    refuse(folder_.string() + " is no site",
           "make one with `suture keys init " + folder_.string() + "`");
  lock_ = ::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (lock_ < 0) cannot("opening", folder_);
  if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_);
    refuse("another process works on the site " + folder_.string(), "wait until it has ended");
  }
  try {
    for (const auto& json : nlohmann::json::parse(read_file(folder_ / kRegister)))
      entries_.push_back(entry_of(json));
  } catch (const nlohmann::json::exception& error) {
    ::close(lock_);
    refuse((folder_ / kRegister).string() + " is damaged: " + error.what(),
           "bring it back from a backup");
  } catch (...) {
    ::close(lock_);
    throw;
  }
}

Site::~Site() { ::close(lock_); }

fs::path Site::folder_of(const std::string& name) const { return folder_ / kIdentities / name; }

Entry& Site::entry(const std::string& name) {
  const auto found = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const Entry& entry) { return entry.name == name; });
  if (found == entries_.end())
    refuse("the site has no identity \"" + name + "\"", "see `suture keys list`");
  return *found;
}

fs::path Site::add(const std::string& name, const Rights& rights, std::int64_t seconds) {
  check_name(name);
  check(rights);
  for (const Entry& entry : entries_)
    if (entry.name == name)
      refuse("the site has an identity \"" + name + "\"" + (entry.revoked ? ", revoked" : ""),
             entry.revoked ? "a name is given once: take another"
                           : "`suture keys renew` it, or take another name");
  const auto before = entries_;
  try {
    return issue(entries_.emplace_back(Entry{name, rights, 0, {}, {}, false}), seconds);
  } catch (...) {
    entries_ = before;
    throw;
  }
}

fs::path Site::renew(const std::string& name, std::int64_t seconds, OldKeys old_keys) {
  Entry& which = entry(name);
  if (which.revoked)
    refuse("\"" + name + "\" is revoked", "a name is given once: add another identity");
  fs::path folder = issue(which, seconds);
  if (old_keys == OldKeys::kRevoke) {
    which.withdrawn_serials.assign(which.serials.begin(), which.serials.end() - 1);
    save();
    publish_revoked();
  }
  return folder;
}

fs::path Site::issue(Entry& which, std::int64_t seconds) {
  const KeyPair authority = authority_of(folder_);
  const std::int64_t now = std::time(nullptr);
  const std::int64_t end = expiry_of(authority.certificate);
  if (now + seconds > end)
    refuse("the site's authority ends on " + date_text(end) + ", before that",
           "give fewer --days, or make a new site");
  // Registered before it exists: what is not registered cannot be revoked.
  which.expires_s = now + seconds;
  which.serials.push_back(make_serial());
  save();
  const KeyPair pair = certify(authority, which.name, which.serials.back(), now, which.expires_s);
  const fs::path folder = folder_of(which.name);
  FolderBeside made(folder);
  write_file(made / key_files::kAuthority, authority.certificate, 0644);
  write_file(made / key_files::kCertificate, pair.certificate, 0644);
  write_file(made / key_files::kKey, pair.key, 0600);
  write_file(made / key_files::kGovernance, read_file(folder_ / key_files::kGovernance), 0644);
  write_file(made / key_files::kPermissions,
             sign(authority, permissions_xml(subject_of(pair.certificate), which.rights, now,
                                             which.expires_s)),
             0644);
  write_file(made / key_files::kRevoked, read_file(folder_ / key_files::kRevoked), 0644);
  made.replace();
  return folder;
}

void Site::revoke(const std::string& name) {
  Entry& which = entry(name);
  which.revoked = true;
  save();
  publish_revoked();
}

void Site::publish_revoked() const {
  const std::string list =
      revocation_list(authority_of(folder_), revoked_serials(entries_), std::time(nullptr));
  write_file(folder_ / key_files::kRevoked, list, 0644);
  for (const Entry& other : entries_)
    if (fs::is_directory(folder_of(other.name)))
      write_file(folder_of(other.name) / key_files::kRevoked, list, 0644);
}

void Site::save() const {
  nlohmann::json all = nlohmann::json::array();
  for (const Entry& entry : entries_) all.push_back(json_of(entry));
  write_file(folder_ / kRegister, all.dump(1) + "\n", 0600);
}

}  // namespace suture::keys
