// SPDX-License-Identifier: Apache-2.0
#include "protocol/network.hpp"

#include <arpa/inet.h>
#include <dirent.h>
#include <ifaddrs.h>
#include <linux/filter.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "suture/error.hpp"

namespace suture {
namespace {

constexpr const char* kLoopback = "127.0.0.1";
constexpr std::size_t kPeersMax = 100;
// A participant's ports follow from its number on the machine, for which the first free one is
// taken; who looks for participants asks all of these.
constexpr int kParticipantsMax = 99;

std::string environment(const char* name) {
  // concurrency: read once at set-up; nothing in this library calls setenv.
  const char* value = std::getenv(name);  // NOLINT(concurrency-mt-unsafe)
  return value == nullptr ? "" : value;
}

std::string text_of(const sockaddr* address) {
  char text[INET_ADDRSTRLEN] = "";
  inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(address)->sin_addr, text, sizeof text);
  return text;
}

std::uint32_t number_of(const std::string& address) {
  in_addr number{};
  inet_pton(AF_INET, address.c_str(), &number);
  return ntohl(number.s_addr);
}

std::string address_of_interface(const std::string& wished) {
  ifaddrs* raw = nullptr;
  if (getifaddrs(&raw) != 0)
    throw Error(ErrorCode::kNetwork, "this machine's interfaces cannot be read", "");
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> all(raw, &freeifaddrs);
  std::string there;
  for (const ifaddrs* each = raw; each != nullptr; each = each->ifa_next) {
    if (each->ifa_addr == nullptr || each->ifa_addr->sa_family != AF_INET) continue;
    const std::string address = text_of(each->ifa_addr);
    if (wished == each->ifa_name || wished == address) return address;
    there += (there.empty() ? "" : ", ") + std::string(each->ifa_name) + " (" + address + ")";
  }
  throw Error(ErrorCode::kNetwork, "there is no interface \"" + wished + "\" with an IPv4 address",
              "this machine has " + there);
}

std::string address_of_host(const std::string& host) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int fault = getaddrinfo(host.c_str(), nullptr, &hints, &found);
  if (fault != 0)
    throw Error(ErrorCode::kNetwork,
                "the peer \"" + host + "\" is not known: " + gai_strerror(fault),
                "give its IPv4 address, or make its name known to this machine");
  const std::string address = text_of(found->ai_addr);
  freeaddrinfo(found);
  return address;
}

std::vector<std::string> split(const std::string& list) {
  std::vector<std::string> words;
  for (std::size_t at = 0; at < list.size();) {
    const std::size_t end = std::min(list.find(',', at), list.size());
    if (end > at) words.push_back(list.substr(at, end - at));
    at = end + 1;
  }
  return words;
}

/// What passes: datagrams to `network.address`, from its peers where these are listed.
std::vector<sock_filter> filter_of(const Network& network) {
  constexpr auto kFrom = static_cast<std::uint32_t>(SKF_NET_OFF + 12);
  constexpr auto kTo = static_cast<std::uint32_t>(SKF_NET_OFF + 16);
  constexpr std::uint32_t kAll = 0xffffffff;
  std::vector<sock_filter> program;
  const auto load = [&](std::uint32_t at) {
    program.push_back(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, at));
  };
  const auto answer = [&](std::uint32_t bytes) {
    program.push_back(BPF_STMT(BPF_RET | BPF_K, bytes));
  };
  load(kTo);
  program.push_back(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, number_of(network.address), 1, 0));
  answer(0);
  if (network.only_peers) {
    load(kFrom);
    const auto count = static_cast<std::uint8_t>(network.peers.size());
    for (std::uint8_t i = 0; i < count; ++i)
      program.push_back(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, number_of(network.peers[i]),
                                 static_cast<std::uint8_t>(count - i), 0));
    answer(0);
  }
  answer(kAll);
  return program;
}

/// Says whether a descriptor is a socket by which Cyclone hears a domain.
bool hears_domain(int descriptor, std::uint32_t network_domain) {
  int type = 0;
  socklen_t size = sizeof type;
  if (getsockopt(descriptor, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM)
    return false;
  sockaddr_in bound{};
  size = sizeof bound;
  if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&bound), &size) != 0 ||
      bound.sin_family != AF_INET || bound.sin_addr.s_addr != htonl(INADDR_ANY))
    return false;
  const std::uint32_t first = 7400 + 250 * network_domain;  // of the RTPS standard
  const std::uint32_t port = ntohs(bound.sin_port);
  return port >= first && port < first + 250;
}

}  // namespace

Network find_network(const NetworkOptions& options, bool secured) {
  const std::string uri = environment("CYCLONEDDS_URI");
  for (const char* what : {"Interface", "NetworkInterfaceAddress", "AllowMulticast", "<Peer"})
    if (uri.find(what) != std::string::npos)
      throw Error(ErrorCode::kBadInput,
                  "CYCLONEDDS_URI sets interfaces, multicast or peers, which are ours to set",
                  "take that out of it, and say --interface and --peer, or SUTURE_INTERFACE and "
                  "SUTURE_PEERS");
  Network network;
  const std::string interface =
      options.interface.empty() ? environment("SUTURE_INTERFACE") : options.interface;
  network.address = interface.empty() ? kLoopback : address_of_interface(interface);
  const std::vector<std::string> listed =
      options.peers.empty() ? split(environment("SUTURE_PEERS")) : options.peers;
  if (listed.size() > kPeersMax)
    throw Error(ErrorCode::kBadInput, std::to_string(listed.size()) + " peers are too many",
                "list up to " + std::to_string(kPeersMax));
  network.only_peers = !listed.empty();
  network.peers.push_back(network.address);
  for (const std::string& host : listed) {
    const std::string address = address_of_host(host);
    if (std::find(network.peers.begin(), network.peers.end(), address) == network.peers.end())
      network.peers.push_back(address);
  }
  if (!network.loopback() && !secured && !options.unsecured &&
      environment("SUTURE_UNSECURED_NETWORK") != "1")
    throw Error(
        ErrorCode::kPermissionDenied,
        "without keys, whoever is on the network of " + network.address + " could drive tools",
        "give keys with --security FOLDER (`suture keys`), or say --unsecured-network");
  return network;
}

std::string network_configuration(const Network& network) {
  std::string xml =
      "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface address=\"" +
      network.address +
      "\"/></Interfaces><AllowMulticast>false</AllowMulticast></General>"
      "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>" +
      std::to_string(kParticipantsMax) + "</MaxAutoParticipantIndex><Peers>";
  for (const std::string& peer : network.peers) xml += "<Peer address=\"" + peer + "\"/>";
  return xml + "</Peers></Discovery></Domain></CycloneDDS>";
}

void confine_sockets(std::uint32_t network_domain, const Network& network) {
  std::vector<sock_filter> program = filter_of(network);
  const sock_fprog filter{static_cast<unsigned short>(program.size()), program.data()};
  struct Close {
    void operator()(DIR* folder) const noexcept { closedir(folder); }
  };
  const std::unique_ptr<DIR, Close> descriptors(opendir("/proc/self/fd"));
  if (!descriptors) throw Error(ErrorCode::kNetwork, "/proc/self/fd cannot be read", "mount /proc");
  while (const dirent* entry = readdir(descriptors.get())) {
    const int descriptor = std::atoi(entry->d_name);
    if (!hears_domain(descriptor, network_domain)) continue;
    if (setsockopt(descriptor, SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter) != 0)
      throw Error(ErrorCode::kNetwork,
                  std::string("the kernel does not confine a socket: ") + std::strerror(errno),
                  "permit setsockopt(SO_ATTACH_FILTER) to this process");
  }
}

}  // namespace suture
