// SPDX-License-Identifier: GPL-3.0-or-later
// What a stranger says to the gateway, past HTTP itself: the first byte chooses.
//
//     m   a WebSocket message, as text and as binary
//     r   a request's path, query, host, origin, authorization, subprotocols, one a line
//     t   the file of tokens (that one is the site's own, but edited by hand while it runs)
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>

#include "gateway/access.hpp"
#include "gateway/foxglove.hpp"
#include "gateway/site.hpp"
#include "support/temporary_folder.hpp"
#include "suture/error.hpp"

namespace {

using namespace sutured::gateway;

const sutured::testing::TemporaryFolder& folder() {
  static const sutured::testing::TemporaryFolder instance;
  return instance;
}

void message(const std::string& bytes) {
  const ClientText text = parse_client_text(bytes);
  if (const auto* malformed = std::get_if<Malformed>(&text))
    if (status(StatusLevel::kError, malformed->reason).empty()) std::abort();
  if (const auto* unsupported = std::get_if<Unsupported>(&text))
    (void)status(StatusLevel::kError, unsupported->operation);
  if (const auto* advertised = std::get_if<Advertise>(&text))
    for (const auto& item : advertised->items) (void)status(StatusLevel::kError, item.topic);
  const auto binary = parse_client_binary(std::as_bytes(std::span(bytes)));
  if (binary && binary->payload.size() + 5 != bytes.size()) std::abort();
}

void request(const std::string& lines) {
  static const std::string tokens =
      folder().write("tokens.toml", "[[token]]\nname = \"a\"\nsha256 = \"" + sha256_hex("secret") +
                                        "\"\nrights = [\"drive:left\"]\n");
  static const Site site(folder().path("."));
  static const Access open({"127.0.0.1", "", {}});
  static const Access guarded({"127.0.0.1", tokens, {"https://example.org"}});
  std::istringstream in(lines);
  Request request;
  for (std::string* field : {&request.path, &request.query, &request.host, &request.origin,
                             &request.authorization, &request.subprotocols})
    std::getline(in, *field);
  // Only a name of the table is ever found.
  if (site.get(request).status == 200 && request.path != "/tokens.toml") std::abort();
  (void)open.refuse(request);
  (void)choose_subprotocol(request.subprotocols);
  const bool knows = request.query.find("secret") != std::string::npos ||
                     request.authorization.find("secret") != std::string::npos;
  if (guarded.grant(request) && !knows) std::abort();
}

void tokens(const std::string& text) {
  try {
    static const sutured::testing::TemporaryFolder elsewhere;  // not what the site shows
    const Access access({"10.0.0.1", elsewhere.write("edited.toml", text), {}, true});
    if (access.grant({})) std::abort();
  } catch (const suture::Error& error) {
    if (error.code() != suture::ErrorCode::kBadInput) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string rest(reinterpret_cast<const char*>(data) + 1, size - 1);
  if (data[0] == 'm') message(rest);
  if (data[0] == 'r') request(rest);
  if (data[0] == 't') tokens(rest);
  return 0;
}
