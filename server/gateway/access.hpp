// SPDX-License-Identifier: GPL-3.0-or-later
// Who may come by the web, and what they may do.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "gateway/web_server.hpp"

namespace sutured::gateway {

/// What one web client may do besides looking.
struct Rights {
  bool command = false;              ///< pause, resume, reset, stop, release
  bool drive_all = false;            ///< take any tool that is free
  std::vector<std::uint64_t> tools;  ///< those it may take: suture::tool_id of their names

  [[nodiscard]] bool may_drive(std::uint64_t tool_id) const noexcept;
};

/// A client that was let in.
struct Grant {
  std::string name;    ///< of its token; empty where none is asked for
  std::string digest;  ///< of its token, in hex: tells whether it still holds
  Rights rights;
};

/// Tokens and origins.
///
/// Without a file of tokens everybody on this machine may do everything, and nobody else
/// can come: `--http` then takes loopback addresses only. Others need TLS too, since a token
/// in the clear is everybody's (docs/adr/0044). With a file, each WebSocket and
/// `/metrics` asks for a token. The file holds their SHA-256, not themselves, and is read
/// again when it changes; one that is gone or lists no token while the server runs revokes all:
///
///     [[token]]
///     name = "ward 3"
///     sha256 = "…64 hex digits…"          # printf %s TOKEN | sha256sum
///     rights = ["drive:left", "command"]   # or "drive:*"; looking needs none
///
/// A page of another origin gets in nowhere: a browser names the origin, and it must be
/// the address that was asked for or one of those allowed. A loopback server answers to
/// loopback names only, so that no foreign name that resolves to it (DNS rebinding) works.
/// Threads: the gateway's.
class Access {
 public:
  struct Options {
    std::string address;               ///< of the server, numeric
    std::filesystem::path tokens;      ///< empty: none asked for
    std::vector<std::string> origins;  ///< allowed besides its own: `https://example.org`
    bool tls = false;                  ///< what travels is encrypted
  };

  /// Throws suture::Error kBadInput: a faulty file (with its place), or an address that is
  /// not loopback and no tokens or no TLS.
  explicit Access(Options options);

  /// Returns why a request is refused whatever its token; nothing where it is not.
  [[nodiscard]] std::optional<Reply> refuse(const Request& request) const;
  /// Returns what a request's token allows (`?token=…`, or `Authorization: Bearer …`);
  /// nothing where it has none that holds.
  [[nodiscard]] std::optional<Grant> grant(const Request& request) const;
  /// Tells whether a client that was let in may stay, and renews its rights.
  [[nodiscard]] bool renew(Grant& grant) const;
  /// Reads the file again where it changed. Returns what people must be told, once; empty where
  /// nothing is. A faulty file keeps the tokens there were. One that is gone or lists none revokes
  /// them all, once it is so at two looks in a row: an editor that saves may empty it for a moment.
  std::string reload();

 private:
  struct Token {
    std::string name, digest;
    Rights rights;
  };
  /// None where the file lists none. Throws suture::Error kBadInput.
  [[nodiscard]] static std::vector<Token> read(const std::filesystem::path& file);
  [[nodiscard]] std::string revoke_all(const std::string& why);
  [[nodiscard]] const Token* find(std::string_view digest) const noexcept;

  Options options_;
  bool loopback_ = false;
  std::vector<Token> tokens_;
  std::filesystem::file_time_type read_at_{};
  bool unseen_ = false;     ///< the last look could not tell whether the file is there
  bool none_seen_ = false;  ///< the last look found no token
  bool revoked_ = false;    ///< all, for want of any
};

/// Returns the SHA-256 of `text` in hex.
[[nodiscard]] std::string sha256_hex(std::string_view text);
/// Says whether `address` is numeric and reaches this machine only.
[[nodiscard]] bool is_loopback(std::string_view address) noexcept;

}  // namespace sutured::gateway
