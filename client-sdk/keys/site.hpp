// SPDX-License-Identifier: Apache-2.0
// A site's authority and the identities that it has given.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace suture::keys {

/// What a holder is there for; each is the topics that it may write and read.
enum class Role {
  kServer,    ///< all topics, every tool
  kDevice,    ///< poses of its tools, forces, models
  kViewer,    ///< reads what is to be seen
  kRecorder,  ///< reads everything
  kOperator,  ///< commands, and their replies
};

/// Returns the role of that name (server, device, viewer, recorder, operator). Throws
/// Error kBadInput.
[[nodiscard]] Role role_of(std::string_view name);
[[nodiscard]] const char* name_of(Role role) noexcept;

/// How messages are protected on the network. Insiders hold each other's keys, and can be
/// told apart only by the origin's own code; see docs/adr/0046.
enum class Protection { kSign, kEncrypt, kEncryptWithOrigin };

/// What an identity may do.
struct Rights {
  std::vector<Role> roles;
  std::vector<std::string> tools;  ///< of a device: names as in the scene
  int domain = -1;                 ///< this even domain and the next one only; -1: all
  std::string session;             ///< this session only; empty: all
};

/// An identity as the site knows it.
struct Entry {
  std::string name;
  Rights rights;
  std::int64_t expires_s = 0;                  ///< Unix time
  std::vector<std::string> serials;            ///< hexadecimal, of all its certificates
  std::vector<std::string> withdrawn_serials;  ///< those of them that hold no longer
  bool revoked = false;                        ///< none of them holds, and none will be given
};

/// What becomes of the keys that an identity had before it is renewed: whoever read them is the
/// identity as long as they hold.
enum class OldKeys { kHold, kRevoke };

/// A folder with the site's authority: its key, its register, and a folder for each identity.
///
/// Files are written whole or not at all; folders are 0700, keys 0600. Two processes do not
/// work on one site at once. Threads: one at a time. All throw Error kBadInput or
/// kPermissionDenied, with the mend, and leave the site as it was.
class Site {
 public:
  /// Makes a site in `folder`, which does not exist or is empty.
  static void create(const std::filesystem::path& folder, const std::string& title, int days,
                     Protection protection);

  explicit Site(const std::filesystem::path& folder);
  ~Site();
  Site(const Site&) = delete;
  Site& operator=(const Site&) = delete;

  /// Gives a new identity for `seconds` and returns its folder.
  std::filesystem::path add(const std::string& name, const Rights& rights, std::int64_t seconds);
  /// Gives an identity a new key and new dates, the same rights, and returns its folder. The keys
  /// before hold until they expire, or are withdrawn as by `revoke`; where only that fails, the new
  /// ones are there, and renewing once more withdraws all before.
  std::filesystem::path renew(const std::string& name, std::int64_t seconds,
                              OldKeys old_keys = OldKeys::kHold);
  /// Withdraws all certificates of an identity: renews the list of the revoked, here and in
  /// the folders of all identities.
  void revoke(const std::string& name);

  [[nodiscard]] const std::vector<Entry>& entries() const noexcept { return entries_; }
  [[nodiscard]] std::filesystem::path folder_of(const std::string& name) const;

 private:
  Entry& entry(const std::string& name);
  std::filesystem::path issue(Entry& entry, std::int64_t seconds);
  void publish_revoked() const;
  void save() const;

  std::filesystem::path folder_;
  int lock_ = -1;
  std::vector<Entry> entries_;
};

}  // namespace suture::keys
