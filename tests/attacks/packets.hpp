// SPDX-License-Identifier: GPL-3.0-or-later
// Packets as an eavesdropper keeps them.
#pragma once

#include <netinet/in.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <istream>
#include <ostream>
#include <random>
#include <vector>

namespace sutured::attacks {

struct Packet {
  sockaddr_in to{};
  std::vector<char> bytes;
};

inline void write_packets(std::ostream& file, const std::vector<Packet>& packets) {
  for (const Packet& packet : packets) {
    const auto size = static_cast<std::uint32_t>(packet.bytes.size());
    file.write(reinterpret_cast<const char*>(&packet.to), sizeof packet.to);
    file.write(reinterpret_cast<const char*>(&size), sizeof size);
    file.write(packet.bytes.data(), size);
  }
}

inline std::vector<Packet> read_packets(std::istream& file) {
  std::vector<Packet> packets;
  Packet packet;
  std::uint32_t size = 0;
  while (file.read(reinterpret_cast<char*>(&packet.to), sizeof packet.to) &&
         file.read(reinterpret_cast<char*>(&size), sizeof size)) {
    packet.bytes.resize(size);
    file.read(packet.bytes.data(), size);
    packets.push_back(packet);
  }
  return packets;
}

/// Turns a recorded packet into a forged one of its sender: some bytes behind the header changed;
/// or an unprotected DATA submessage of the sender's writers with a new sequence number; or a
/// HEARTBEAT that would have a reliable reader throw away what it waits for.
inline void forge(std::vector<char>& bytes, std::mt19937& random) {
  constexpr std::size_t kHeader = 20;
  const auto kind = random() % 4;
  if (kind < 2 && bytes.size() > kHeader + 4) {
    for (int i = 0; i < 3; ++i)
      bytes[kHeader + random() % (bytes.size() - kHeader)] = static_cast<char>(random());
    return;
  }
  bytes.resize(kHeader);  // "RTPS", version, vendor, and whose participant it is
  const auto put = [&](const void* data, std::size_t size) {
    const auto* from = static_cast<const char*>(data);
    bytes.insert(bytes.end(), from, from + size);
  };
  const auto put32 = [&](std::uint32_t value) { put(&value, sizeof value); };
  const std::uint32_t reader = 0, sequence = 1U + static_cast<std::uint32_t>(random() % 1000000U);
  const unsigned char writers[2] = {2, 3};  // user writers, with a key and without
  const std::uint32_t number = static_cast<std::uint32_t>(random() % 64U);
  const unsigned char writer[4] = {0, static_cast<unsigned char>(number >> 4U),
                                   static_cast<unsigned char>(number << 4U), writers[random() % 2]};
  if (kind == 2) {
    const unsigned char data[4] = {0x15, 0x05, 20 + 4 + 96, 0};  // DATA, little endian, payload
    put(data, sizeof data);
    const std::uint16_t flags[2] = {0, 16};
    put(flags, sizeof flags);
    put32(reader), put(writer, 4), put32(0), put32(sequence);
    const unsigned char encoding[4] = {0, 1, 0, 0};
    put(encoding, sizeof encoding);
    for (int i = 0; i < 24; ++i) put32(static_cast<std::uint32_t>(random()));
  } else {
    const unsigned char heartbeat[4] = {0x07, 0x01, 28, 0};
    put(heartbeat, sizeof heartbeat);
    put32(reader), put(writer, 4), put32(0), put32(sequence), put32(0), put32(sequence + 100);
    put32(static_cast<std::uint32_t>(random()));
  }
}

}  // namespace sutured::attacks
