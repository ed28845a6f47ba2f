// SPDX-License-Identifier: Apache-2.0
// What a certificate authority does, by OpenSSL: P-256, SHA-256, PEM and S/MIME.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace suture::keys {

/// Clocks of a site's machines differ: what is given holds from so long before, seconds.
inline constexpr std::int64_t kClockSkew_s = 3600;

/// A private key and its certificate, as PEM.
struct KeyPair {
  std::string key;
  std::string certificate;
};

/// Returns a new authority: a key and the certificate that it signed itself, for `days`.
/// All of this header throw Error kBadInput where PEM is damaged or OpenSSL refuses.
[[nodiscard]] KeyPair make_authority(const std::string& title, std::int64_t now_s, int days);

/// Returns a new serial number, 128 random bits as hexadecimal digits.
[[nodiscard]] std::string make_serial();

/// Returns a new key, certified by `authority` for `name` from `kClockSkew_s` before `now_s`
/// until `expires_s`.
[[nodiscard]] KeyPair certify(const KeyPair& authority, const std::string& name,
                              const std::string& serial, std::int64_t now_s,
                              std::int64_t expires_s);

/// Returns the holder of a certificate as RFC 2253 writes it: `CN=driver-1,O=…`.
[[nodiscard]] std::string subject_of(const std::string& certificate);
/// Returns when a certificate ends, Unix time.
[[nodiscard]] std::int64_t expiry_of(const std::string& certificate);

/// Returns `text` with the authority's signature, S/MIME in clear.
[[nodiscard]] std::string sign(const KeyPair& authority, const std::string& text);

/// Returns the authority's list of revoked certificates.
[[nodiscard]] std::string revocation_list(const KeyPair& authority,
                                          const std::vector<std::string>& serials,
                                          std::int64_t now_s);

}  // namespace suture::keys
