// SPDX-License-Identifier: Apache-2.0
// A folder of keys: who its holder is, and how DDS Security is told so.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace suture {

/// Files of an identity's folder, as `suture keys add` makes them.
namespace key_files {
inline constexpr const char* kAuthority = "ca.pem";             ///< the site's certificate
inline constexpr const char* kCertificate = "certificate.pem";  ///< the holder's
inline constexpr const char* kKey = "key.pem";                  ///< private, of its owner alone
inline constexpr const char* kGovernance = "governance.p7s";    ///< what is protected, signed
inline constexpr const char* kPermissions = "permissions.p7s";  ///< what the holder may, signed
inline constexpr const char* kRevoked = "crl.pem";              ///< certificates withdrawn
}  // namespace key_files

/// What begins a partition that stands for a tool, and therefore no session's name.
inline constexpr char kToolMark = '@';

/// Returns the partition that a device's writers add to their session's to claim `tool`.
/// DDS Security lets a writer into it by the device's signed permissions alone, and the
/// server takes poses for a tool only from writers that are in its partition.
[[nodiscard]] std::string tool_partition(std::string_view tool);

/// Domains that documents can name: Cyclone DDS 0.10 takes one that names 231 for damaged.
inline constexpr std::uint32_t kSecuredDomains = 230;

/// Returns the number by which the process itself calls a network's domain where it takes part in
/// it a second time (`ParticipantOptions::separate`) with keys. Cyclone holds documents against
/// that number, so it is one that they can name: another domain's, as far away as there is.
[[nodiscard]] constexpr std::uint32_t separate_secured_domain(std::uint32_t domain) noexcept {
  constexpr std::uint32_t kAway = 116;  // even, so that forces stay apart from meshes
  return (domain + kAway) % kSecuredDomains;
}

/// What a folder of keys says of its holder.
struct Identity {
  std::string folder;
  std::string name;                ///< CN of the certificate
  std::int64_t expires_s = 0;      ///< Unix time: certificate or permissions, whichever ends first
  std::vector<std::string> tools;  ///< that it may drive; "*": every one
  /// What DDS Security is told: properties of a participant's QoS.
  std::vector<std::pair<std::string, std::string>> properties;

  [[nodiscard]] bool may_drive(std::string_view tool) const noexcept;
};

/// Reads a folder of keys and checks all that can be checked without a peer: files, who may
/// read the key, that certificate, key, governance and permissions belong together and to
/// the folder's authority, dates, and the list of the revoked.
///
/// Throws Error kPermissionDenied that names the file, the cause and the mend.
[[nodiscard]] Identity read_identity(const std::string& folder);

/// Returns the folder of keys to use: `chosen`, or where that is empty the environment's
/// `SUTURE_SECURITY`; nothing, where neither says or one says "off": unsecured.
[[nodiscard]] std::string security_folder(const std::string& chosen);

/// Writes a time as UTC, by a format of strftime whose result has at most 31 characters.
[[nodiscard]] std::string utc_text(std::int64_t unix_s, const char* format);

/// Says for people when keys end: `2027-01-31`.
[[nodiscard]] std::string date_text(std::int64_t unix_s);

}  // namespace suture
