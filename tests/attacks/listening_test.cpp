// SPDX-License-Identifier: GPL-3.0-or-later
// What a running server hears: nothing but what is sent to the address it was told, and where peers
// are listed, nothing but what these send.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "support/process.hpp"
#include "support/test_session.hpp"

namespace sutured {
namespace {

struct Socket {
  std::string address;  // as the kernel writes it
  unsigned port = 0;
  unsigned long long dropped = 0;
};

std::set<std::string> inodes_of(pid_t process) {
  std::set<std::string> inodes;
  for (const auto& entry :
       std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/fd")) {
    std::error_code gone;
    const std::string target = std::filesystem::read_symlink(entry.path(), gone).string();
    if (target.starts_with("socket:[")) inodes.insert(target.substr(8, target.size() - 9));
  }
  return inodes;
}

/// Sockets of a process in a table of /proc/net that can be reached: every one of UDP, and those
/// of TCP that listen.
std::vector<Socket> sockets_of(pid_t process, const std::string& table) {
  const std::set<std::string> inodes = inodes_of(process);
  std::vector<Socket> sockets;
  std::ifstream file("/proc/net/" + table);
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::vector<std::string> word;
    for (std::string each; words >> each;) word.push_back(each);
    if (word.size() < 10 || !inodes.contains(word[9])) continue;
    if (table.starts_with("tcp") && word[3] != "0A") continue;
    const std::size_t colon = word[1].find(':');
    sockets.push_back({word[1].substr(0, colon),
                       static_cast<unsigned>(std::stoul(word[1].substr(colon + 1), nullptr, 16)),
                       table.starts_with("udp") ? std::stoull(word.back()) : 0});
  }
  return sockets;
}

in_addr number_of(const std::string& address) {
  in_addr number{};
  EXPECT_EQ(inet_pton(AF_INET, address.c_str(), &number), 1) << address;
  return number;
}

/// An address as the kernel writes it.
std::string by_the_kernel(const std::string& address) {
  char text[9];
  std::snprintf(text, sizeof text, "%08X", number_of(address).s_addr);
  return text;
}

/// Enough to tell them from what a server says to itself meanwhile, some datagrams a second, and
/// few enough for the buffer of a socket.
constexpr unsigned long long kDatagrams = 64;

/// Sends `kDatagrams` to an address of this machine, from another of its own where that is said.
void send_some(const std::string& to, unsigned port, const std::string& from) {
  const int socket = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  if (!from.empty()) {
    address.sin_addr = number_of(from);
    EXPECT_EQ(::bind(socket, reinterpret_cast<sockaddr*>(&address), sizeof address), 0) << from;
  }
  address.sin_addr = number_of(to);
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  const char text[] = "is anybody there";
  for (unsigned long long i = 0; i < kDatagrams; ++i)
    EXPECT_GT(::sendto(socket, text, sizeof text, 0, reinterpret_cast<sockaddr*>(&address),
                       sizeof address),
              0);
  ::close(socket);
}

/// The first interface of this machine that is not loopback and its address; empty: none.
std::pair<std::string, std::string> outside() {
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return {};
  std::pair<std::string, std::string> found;
  for (const ifaddrs* each = all; each != nullptr && found.first.empty(); each = each->ifa_next) {
    if (each->ifa_addr == nullptr || each->ifa_addr->sa_family != AF_INET ||
        (each->ifa_flags & IFF_LOOPBACK) != 0 || (each->ifa_flags & IFF_UP) == 0)
      continue;
    char text[INET_ADDRSTRLEN] = "";
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(each->ifa_addr)->sin_addr, text,
              sizeof text);
    found = {each->ifa_name, text};
  }
  freeifaddrs(all);
  return found;
}

/// Where a datagram goes and where it comes from; "": from where it goes.
struct Way {
  std::string to, from;
};

/// What a server is told, and what it hears then.
struct Network {
  std::string name, here;
  std::vector<std::string> told;
  std::vector<Way> heard, dropped;
};

std::ostream& operator<<(std::ostream& to, const Network& network) { return to << network.name; }

/// Every address of 127.0.0.0/8 is this machine.
std::vector<Network> networks() {
  std::vector<Network> all{{"Loopback",
                            "127.0.0.1",
                            {},
                            {{"127.0.0.1", ""}, {"127.0.0.1", "127.0.0.3"}},
                            {{"127.0.0.2", ""}}},
                           {"ListedPeer",
                            "127.0.0.1",
                            {"--peer", "127.0.0.2"},
                            {{"127.0.0.1", "127.0.0.2"}, {"127.0.0.1", "127.0.0.1"}},
                            {{"127.0.0.1", "127.0.0.3"}, {"127.0.0.2", "127.0.0.2"}}}};
  const auto [name, address] = outside();
  all.push_back({"NamedInterface",
                 address,
                 {"--interface", name, "--unsecured-network"},
                 {{address, ""}},
                 {{"127.0.0.1", ""}, {"127.0.0.2", ""}}});
  return all;
}

class Listening : public ::testing::TestWithParam<Network> {};

TEST_P(Listening, AServerHearsOneAddressAlone) {
  const Network& network = GetParam();
  if (network.here.empty()) GTEST_SKIP() << "this machine has no interface but loopback";
  const std::string web = by_the_kernel("127.0.0.1"), here = by_the_kernel(network.here);
  const std::string any = by_the_kernel("0.0.0.0");
  const suture::ParticipantOptions session = testing::own_session();
  std::vector<std::string> command{SUTURED_PROGRAM,
                                   "serve",
                                   SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml",
                                   "--domain",
                                   std::to_string(session.domain),
                                   "--session",
                                   session.session,
                                   "--http",
                                   "127.0.0.1:0"};
  command.insert(command.end(), network.told.begin(), network.told.end());
  testing::Process server(command);
  ASSERT_NE(server.read_until("viewer at").find("viewer at"), std::string::npos) << server.output();

  for (const char* table : {"tcp", "tcp6", "udp6", "raw", "raw6"})
    for (const Socket& socket : sockets_of(server.pid(), table))
      EXPECT_EQ(socket.address, web) << table << " port " << socket.port;

  // Cyclone DDS binds its ears to every address; the kernel keeps from them what is not ours.
  const auto dropped = [&](unsigned port) {
    for (const Socket& socket : sockets_of(server.pid(), "udp"))
      if (socket.port == port) return socket.dropped;
    return 0ULL;
  };
  int ears = 0;
  for (const Socket& socket : sockets_of(server.pid(), "udp")) {
    if (socket.address == here) continue;
    ASSERT_EQ(socket.address, any) << "port " << socket.port;
    ++ears;
    for (const Way& way : network.dropped) {
      const unsigned long long before = dropped(socket.port);
      send_some(way.to, socket.port, way.from);
      EXPECT_TRUE(testing::eventually([&] { return dropped(socket.port) >= before + kDatagrams; }))
          << "port " << socket.port << " hears " << way.from << " at " << way.to;
    }
    for (const Way& way : network.heard) {
      const unsigned long long before = dropped(socket.port);
      send_some(way.to, socket.port, way.from);
      // They come in order: once others are dropped, those before them have been heard.
      const Way& other = network.dropped.front();
      send_some(other.to, socket.port, other.from);
      EXPECT_TRUE(testing::eventually([&] { return dropped(socket.port) >= before + kDatagrams; }));
      EXPECT_LT(dropped(socket.port), before + kDatagrams * 3 / 2)
          << "port " << socket.port << " is deaf to " << way.from << " at " << way.to;
    }
  }
  EXPECT_GE(ears, 4);  // two domains, discovery and data
}

INSTANTIATE_TEST_SUITE_P(Of, Listening, ::testing::ValuesIn(networks()),
                         [](const auto& tested) { return tested.param.name; });

}  // namespace
}  // namespace sutured
