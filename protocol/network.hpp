// SPDX-License-Identifier: Apache-2.0
// The interface and the peers of a session, and that nothing is heard but by these.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "suture/network.hpp"

namespace suture {

/// Where to take part, as addresses. IPv4, dotted.
struct Network {
  std::string address;             ///< own
  std::vector<std::string> peers;  ///< with ourselves; as listed, else ourselves alone
  bool only_peers = false;         ///< peers were listed: what others send is not heard

  [[nodiscard]] bool loopback() const noexcept { return address.starts_with("127."); }
};

/// Looks up interface and peers, here and in the environment. Throws Error kBadInput or
/// kNetwork with the mend; kPermissionDenied where `secured` is false, the interface is not
/// loopback, and nobody said that this is meant.
[[nodiscard]] Network find_network(const NetworkOptions& options, bool secured);

/// Returns Cyclone's settings for it, as a fragment of its own: this interface, no multicast, these
/// peers.
[[nodiscard]] std::string network_configuration(const Network& network);

/// Closes the ears of this process's sockets of one domain: Cyclone DDS binds them to every
/// address of the machine, whatever interface it is told; from here on the kernel drops what is
/// not sent to `network.address`, and where peers are listed what does not come from one of them,
/// before Cyclone sees it. Throws Error kNetwork where the kernel refuses.
void confine_sockets(std::uint32_t network_domain, const Network& network);

}  // namespace suture
