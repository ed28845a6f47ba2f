// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/access.hpp"

#include <arpa/inet.h>
#include <openssl/crypto.h>
#include <openssl/evp.h>

#include <toml++/toml.h>
#include <algorithm>
#include <array>
#include <boost/url/parse_query.hpp>
#include <sstream>
#include <system_error>
#include <utility>

#include "geometry/regular_file.hpp"
#include "protocol/types.hpp"
#include "suture/error.hpp"

namespace sutured::gateway {
namespace {

constexpr std::size_t kDigest = 64;  // hex digits
constexpr std::uint64_t kFileMax = 1U << 20U;
constexpr const char* kMend = "a token has name, sha256 and rights: docs/guide/viewer.md";

std::string lower(std::string_view text) {
  std::string result(text);
  std::transform(result.begin(), result.end(), result.begin(), [](char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  });
  return result;
}

// `127.0.0.1:8080` without its port; `[::1]:8080` without that and the brackets.
std::string host_of(std::string_view authority) {
  if (authority.starts_with('[')) return lower(authority.substr(1, authority.find(']') - 1));
  return lower(authority.substr(0, authority.find(':')));
}

// The value of `token` in `a=b&token=d`, as a form encodes it; empty where there is none.
std::string token_in(std::string_view query) {
  const auto parameters = boost::urls::parse_query(query);
  if (!parameters) return {};
  const auto found = parameters->find("token");
  if (found == parameters->end()) return {};
  boost::urls::encoding_opts form;
  form.space_as_plus = true;
  return (*found).value.decode(form);
}

std::string token_of(const Request& request) {
  constexpr std::string_view kBearer = "Bearer ";
  if (request.authorization.starts_with(kBearer))
    return request.authorization.substr(kBearer.size());
  return token_in(request.query);
}

[[noreturn]] void refuse_file(const std::filesystem::path& file, const toml::source_region& place,
                              const std::string& what) {
  std::ostringstream where;
  where << file.string() << ':' << place.begin.line << ':' << place.begin.column << ": " << what;
  throw suture::Error(suture::ErrorCode::kBadInput, where.str(), kMend);
}

}  // namespace

bool Rights::may_drive(std::uint64_t tool_id) const noexcept {
  return drive_all || std::find(tools.begin(), tools.end(), tool_id) != tools.end();
}

std::string sha256_hex(std::string_view text) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  EVP_Digest(text.data(), text.size(), digest.data(), &size, EVP_sha256(), nullptr);
  constexpr std::string_view kHex = "0123456789abcdef";
  std::string hex;
  for (unsigned i = 0; i < size; ++i) {
    hex += kHex[digest[i] >> 4U];
    hex += kHex[digest[i] & 15U];
  }
  return hex;
}

bool is_loopback(std::string_view address) noexcept {
  std::array<char, INET6_ADDRSTRLEN + 1> text{};
  if (address.size() >= text.size()) return false;
  std::copy(address.begin(), address.end(), text.begin());
  in_addr v4{};
  if (inet_pton(AF_INET, text.data(), &v4) == 1) return ntohl(v4.s_addr) >> 24U == 127;
  in6_addr v6{};
  return inet_pton(AF_INET6, text.data(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6) != 0;
}

Access::Access(Options options)
    : options_(std::move(options)), loopback_(is_loopback(options_.address)) {
  if (!loopback_ && options_.tokens.empty())
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "--http " + options_.address + " would let everybody in",
                        "give --http-tokens FILE (docs/guide/viewer.md), or a loopback address");
  if (!loopback_ && !options_.tls)
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "--http " + options_.address + " would send tokens in the clear",
                        "give --http-certificate FILE and --http-key FILE, or a loopback address");
  if (options_.tokens.empty()) return;
  std::error_code error;
  read_at_ = std::filesystem::last_write_time(options_.tokens, error);
  tokens_ = read(options_.tokens);
  if (tokens_.empty())
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "the tokens " + options_.tokens.string() + ": there is no [[token]]",
                        kMend);
}

std::vector<Access::Token> Access::read(const std::filesystem::path& file) {
  toml::table table;
  try {
    table = toml::parse(geometry::read_regular_file(file.string(), kFileMax), file.string());
  } catch (const geometry::FileError& error) {
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "the tokens " + file.string() + ": " + error.what(),
                        "give --http-tokens a file as in docs/guide/viewer.md");
  } catch (const toml::parse_error& error) {
    refuse_file(file, error.source(), std::string(error.description()));
  }
  for (const auto& [key, value] : table)
    if (key != "token")
      refuse_file(file, value.source(), "unknown key \"" + std::string(key) + "\"");
  std::vector<Token> tokens;
  if (!table.contains("token")) return tokens;
  const toml::array* list = table["token"].as_array();
  if (list == nullptr)
    refuse_file(file, table["token"].node()->source(), "\"token\" must be a [[token]]");
  for (const toml::node& node : *list) {
    const toml::table* entry = node.as_table();
    if (entry == nullptr) refuse_file(file, node.source(), "\"token\" must be a [[token]]");
    for (const auto& [key, value] : *entry)
      if (key != "name" && key != "sha256" && key != "rights")
        refuse_file(file, value.source(), "unknown key \"" + std::string(key) + "\"");
    Token token;
    token.name = (*entry)["name"].value_or(std::string());
    if (token.name.empty()) refuse_file(file, entry->source(), "a token needs a name");
    token.digest = lower((*entry)["sha256"].value_or(std::string()));
    if (token.digest.size() != kDigest ||
        token.digest.find_first_not_of("0123456789abcdef") != std::string::npos)
      refuse_file(file, entry->source(), "\"sha256\" must be 64 hex digits");
    const toml::array* rights = (*entry)["rights"].as_array();
    if (rights == nullptr)
      refuse_file(file, entry->source(), "\"rights\" must be a list; [] is to look only");
    for (const toml::node& node_of_right : *rights) {
      const std::string right = node_of_right.value_or(std::string());
      constexpr std::string_view kDrive = "drive:";
      if (right == "command") {
        token.rights.command = true;
      } else if (right == "drive:*") {
        token.rights.drive_all = true;
      } else if (right.starts_with(kDrive) && right.size() > kDrive.size()) {
        token.rights.tools.push_back(suture::tool_id(right.substr(kDrive.size())));
      } else {
        refuse_file(file, node_of_right.source(),
                    "a right is \"command\", \"drive:*\" or \"drive:TOOL\"");
      }
    }
    tokens.push_back(std::move(token));
  }
  return tokens;
}

// Compares with every token in the same time, whichever fits.
const Access::Token* Access::find(std::string_view digest) const noexcept {
  const Token* found = nullptr;
  for (const Token& token : tokens_)
    if (digest.size() == kDigest && CRYPTO_memcmp(token.digest.data(), digest.data(), kDigest) == 0)
      found = &token;
  return found;
}

std::optional<Reply> Access::refuse(const Request& request) const {
  if (loopback_) {
    const std::string host = host_of(request.host);
    if (host != "localhost" && !is_loopback(host))
      return plain_reply(403, "this server answers to loopback names only");
  }
  if (request.origin.empty()) return std::nullopt;  // not from a page
  const std::string origin = lower(request.origin);
  const std::string host = lower(request.host);
  if (origin == "http://" + host || origin == "https://" + host) return std::nullopt;
  for (const std::string& allowed : options_.origins)
    if (origin == lower(allowed)) return std::nullopt;
  return plain_reply(403, "pages of that origin may not connect: --http-origin allows one");
}

std::optional<Grant> Access::grant(const Request& request) const {
  if (options_.tokens.empty()) {
    Grant everything;
    everything.rights.command = everything.rights.drive_all = true;
    return everything;
  }
  const std::string text = token_of(request);
  if (text.empty()) return std::nullopt;
  const Token* token = find(sha256_hex(text));
  if (token == nullptr) return std::nullopt;
  return Grant{token->name, token->digest, token->rights};
}

bool Access::renew(Grant& grant) const {
  if (options_.tokens.empty()) return true;
  const Token* token = find(grant.digest);
  if (token == nullptr) return false;
  grant.rights = token->rights;
  return true;
}

std::string Access::reload() {
  if (options_.tokens.empty()) return {};
  std::error_code error;
  const auto written = std::filesystem::last_write_time(options_.tokens, error);
  if (error == std::errc::no_such_file_or_directory) {
    read_at_ = {};  // whatever comes back is read, whenever it was written
    return revoke_all("is gone");
  }
  const std::string still =
      tokens_.empty() ? " (there are none that hold)" : " (the tokens read before still hold)";
  if (error) {
    none_seen_ = false;
    if (std::exchange(unseen_, true)) return {};
    return "the tokens " + options_.tokens.string() + ": " + error.message() + still;
  }
  unseen_ = false;
  if (written == read_at_) {
    none_seen_ = false;
    return {};
  }
  try {
    std::vector<Token> tokens = read(options_.tokens);
    if (tokens.empty()) {
      // It is looked at again though it does not change, until it counts.
      std::string told = revoke_all("lists none any more");
      if (revoked_) read_at_ = written;
      return told;
    }
    tokens_ = std::move(tokens);
    none_seen_ = revoked_ = false;
  } catch (const suture::Error& fault) {
    none_seen_ = false;
    read_at_ = written;
    return fault.what() + still;
  }
  read_at_ = written;
  return {};
}

std::string Access::revoke_all(const std::string& why) {
  unseen_ = false;
  if (!std::exchange(none_seen_, true) || revoked_) return {};
  revoked_ = true;
  tokens_.clear();
  return "the file of tokens " + options_.tokens.string() + " " + why +
         ": all tokens are revoked, until it lists one again";
}

}  // namespace sutured::gateway
