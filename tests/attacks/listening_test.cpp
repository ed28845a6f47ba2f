// SPDX-License-Identifier: GPL-3.0-or-later
// What a running server hears: nothing but what is sent to the address it was told.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>
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

void send_to(const std::string& address, unsigned port) {
  const int socket = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<std::uint16_t>(port));
  inet_pton(AF_INET, address.c_str(), &to.sin_addr);
  const char text[] = "is anybody there";
  EXPECT_GT(::sendto(socket, text, sizeof text, 0, reinterpret_cast<sockaddr*>(&to), sizeof to), 0);
  ::close(socket);
}

TEST(Listening, AServerHearsOneAddressAlone) {
  constexpr const char* kHere = "0100007F";  // 127.0.0.1, as the kernel writes it
  constexpr const char* kAny = "00000000";
  const suture::ParticipantOptions session = testing::own_session();
  testing::Process server({SUTURED_PROGRAM, "serve",
                           SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml", "--domain",
                           std::to_string(session.domain), "--session", session.session, "--http",
                           "127.0.0.1:0"});
  server.read_until("viewer at");

  for (const char* table : {"tcp", "tcp6", "udp6", "raw", "raw6"})
    for (const Socket& socket : sockets_of(server.pid(), table))
      EXPECT_EQ(socket.address, kHere) << table << " port " << socket.port;

  // Cyclone DDS binds its ears to every address; the kernel keeps from them what is not ours.
  const auto dropped = [&](unsigned port) {
    for (const Socket& socket : sockets_of(server.pid(), "udp"))
      if (socket.port == port) return socket.dropped;
    return 0ULL;
  };
  int ears = 0;
  for (const Socket& socket : sockets_of(server.pid(), "udp")) {
    if (socket.address == kHere) continue;
    ASSERT_EQ(socket.address, kAny) << "port " << socket.port;
    ++ears;
    const unsigned long long before = dropped(socket.port);
    send_to("127.0.0.2", socket.port);  // this machine as well, and not the address named
    EXPECT_TRUE(testing::eventually([&] { return dropped(socket.port) == before + 1; }))
        << "port " << socket.port << " hears another address";
    send_to("127.0.0.1", socket.port);
    EXPECT_EQ(dropped(socket.port), before + 1) << "port " << socket.port << " is deaf";
  }
  EXPECT_GE(ears, 4);  // two domains, discovery and data
}

}  // namespace
}  // namespace sutured
