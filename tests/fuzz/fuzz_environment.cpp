// SPDX-License-Identifier: GPL-3.0-or-later
// Values of the environment, a NAME=VALUE a line: where they have a participant go, and with which
// keys. It goes nowhere.
#include <arpa/inet.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>

#include "protocol/network.hpp"
#include "protocol/security.hpp"
#include "suture/error.hpp"

namespace {

constexpr const char* kNames[] = {"SUTURE_INTERFACE", "SUTURE_PEERS", "SUTURE_SECURITY",
                                  "SUTURE_UNSECURED_NETWORK", "CYCLONEDDS_URI"};

/// Says whether each peer is an address: a name would be asked of the machine's name servers.
bool are_addresses(const std::string& peers) {
  std::istringstream in(peers);
  in_addr address{};
  for (std::string peer; std::getline(in, peer, ',');)
    if (!peer.empty() &&
        (peer.find_first_not_of("0123456789abcdefxABCDEFX.") != std::string::npos ||
         inet_aton(peer.c_str(), &address) == 0))
      return false;
  return true;
}

void require(bool holds) {
  if (!holds) std::abort();
}

void find(bool secured) {
  try {
    const suture::Network network = suture::find_network({}, secured);
    const char* meant = std::getenv("SUTURE_UNSECURED_NETWORK");
    require(secured || network.loopback() || (meant != nullptr && std::string(meant) == "1"));
    in_addr address{};
    for (const std::string& peer : network.peers)
      require(inet_pton(AF_INET, peer.c_str(), &address) == 1);
    require(!network.peers.empty() && network.peers.front() == network.address);
    require(!network_configuration(network).empty());
  } catch (const suture::Error& error) {
    require(error.code() == suture::ErrorCode::kBadInput ||
            error.code() == suture::ErrorCode::kNetwork ||
            (error.code() == suture::ErrorCode::kPermissionDenied && !secured));
    require(!error.mend().empty());
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  for (const char* name : kNames) unsetenv(name);
  std::istringstream in(std::string(reinterpret_cast<const char*>(data), size));
  for (std::string line; std::getline(in, line);) {
    const std::size_t equals = line.find('=');
    for (const char* name : kNames)
      if (line.substr(0, equals) == name && equals != std::string::npos)
        setenv(name, line.c_str() + equals + 1, 1);
  }
  const char* peers = std::getenv("SUTURE_PEERS");
  if (peers != nullptr && !are_addresses(peers)) return 0;
  find(false);
  find(true);
  const std::string folder = suture::security_folder("");
  const char* wished = std::getenv("SUTURE_SECURITY");
  require(folder.empty() || (wished != nullptr && folder == wished));
  require(suture::security_folder("off").empty());
  return 0;
}
