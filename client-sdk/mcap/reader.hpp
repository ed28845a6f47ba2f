// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <fstream>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mcap/records.hpp"
#include "suture/error.hpp"

namespace suture::mcap {

/// Reads an MCAP file front to back: chunks without compression or with zstd, messages
/// outside of chunks. What it does not know it skips.
///
/// A file that was cut off, or is damaged from some place on, reads as far as it is whole:
/// `next` ends there, and `damage` says where and why. Every chunk with a CRC is checked
/// before its first message is given.
/// Threads: one at a time. Memory: one chunk, of at most 256 MiB.
class Reader {
 public:
  /// Throws Error kBadInput where the file cannot be opened or is not MCAP.
  explicit Reader(const std::string& path);

  /// Moves to the next message; false at the end. `message.data` is valid until the next call.
  bool next(Message& message);

  /// Returns the channel of a message that `next` gave.
  [[nodiscard]] const Channel& channel(const Message& message) const {
    return channels_.at(message.channel);
  }
  /// Returns the channel's schema; null where it has none.
  [[nodiscard]] const Schema* schema(const Channel& channel) const;
  /// Returns the metadata met so far, in the order of the file.
  [[nodiscard]] const std::vector<Metadata>& metadata() const noexcept { return metadata_; }
  /// Says where and why reading ended early; empty where it did not, or not yet.
  [[nodiscard]] const std::string& damage() const noexcept { return damage_; }

 private:
  bool next_record();
  bool use(Opcode opcode, std::span<const std::byte> content, Message* message);
  bool open_chunk(std::span<const std::byte> content);
  bool damaged(const std::string& what);

  std::string path_;
  std::ifstream file_;
  std::uint64_t size_ = 0, at_ = 0;  // at_: of the next record
  std::uint64_t place_ = 0;          // of the record in hand
  std::vector<std::byte> record_, chunk_;
  std::size_t chunk_at_ = 0;      // what of chunk_ is read
  std::optional<Message> loose_;  // one outside of chunks, in record_
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  std::vector<Metadata> metadata_;
  std::string damage_;
  bool ended_ = false;
};

}  // namespace suture::mcap
