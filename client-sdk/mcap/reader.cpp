// SPDX-License-Identifier: Apache-2.0
#include "mcap/reader.hpp"

#include <zstd.h>

#include <algorithm>
#include <boost/crc.hpp>
#include <cerrno>
#include <filesystem>
#include <system_error>

namespace suture::mcap {
namespace {

constexpr std::uint64_t kMost = 256U << 20U;  // of a record or chunk; ours have one

bool is_read(Opcode opcode) {
  switch (opcode) {
    case Opcode::kHeader:
    case Opcode::kSchema:
    case Opcode::kChannel:
    case Opcode::kMessage:
    case Opcode::kChunk:
    case Opcode::kMetadata:
      return true;
    default:
      return false;
  }
}

}  // namespace

Reader::Reader(const std::string& path) : path_(path) {
  std::error_code fault;
  if (!std::filesystem::is_regular_file(path, fault)) {
    throw Error(ErrorCode::kBadInput,
                path + (fault ? ": cannot be read: " + fault.message() : ": is not a regular file"),
                "name a recording (MCAP)");
  }
  file_.open(path, std::ios::binary);
  size_ = std::filesystem::file_size(path, fault);
  if (!file_ || fault) {
    throw Error(ErrorCode::kBadInput,
                path + ": cannot be read: " + std::generic_category().message(errno),
                "check the path and its permissions");
  }
  std::array<char, kMagic.size()> magic{};
  if (!file_.read(magic.data(), magic.size()) ||
      std::memcmp(magic.data(), kMagic.data(), magic.size()) != 0) {
    throw Error(ErrorCode::kBadInput, path + ": is not an MCAP file", "name a recording (MCAP)");
  }
  at_ = magic.size();
}

const Schema* Reader::schema(const Channel& channel) const {
  const auto found = schemas_.find(channel.schema);
  return found == schemas_.end() ? nullptr : &found->second;
}

bool Reader::damaged(const std::string& what) {
  damage_ =
      path_ + ": byte " + std::to_string(place_) + " of " + std::to_string(size_) + ": " + what;
  ended_ = true;
  chunk_.clear();
  chunk_at_ = 0;
  return false;
}

bool Reader::next(Message& message) {
  for (;;) {
    if (chunk_at_ < chunk_.size()) {
      ByteSource source(std::span<const std::byte>(chunk_).subspan(chunk_at_));
      const auto opcode = static_cast<Opcode>(source.get<std::uint8_t>());
      const auto length = source.get<std::uint64_t>();
      const std::span<const std::byte> content = source.take(length);
      if (!source.good()) return damaged("a record in this chunk is longer than the chunk");
      chunk_at_ = chunk_.size() - source.rest().size();
      if (opcode == Opcode::kMessage) {
        if (!use(opcode, content, &message)) return false;
        return true;
      }
      // Metadata stand outside of chunks; in one, packed, there could be any number of them.
      if (opcode != Opcode::kMetadata && !use(opcode, content, nullptr)) return false;
      continue;
    }
    if (loose_) {
      message = *loose_;
      loose_.reset();
      return true;
    }
    if (ended_ || !next_record()) return false;
  }
}

// Reads one record of the file, and uses it; false at the end.
bool Reader::next_record() {
  place_ = at_;
  const std::uint64_t left = size_ - at_;
  if (left == 0) return damaged("the file ends without its closing records: it was cut off");
  std::array<std::byte, kRecordHead> head{};
  if (left < head.size()) return damaged("the file is cut off within a record");
  file_.seekg(static_cast<std::streamoff>(at_));
  if (!file_.read(reinterpret_cast<char*>(head.data()), head.size())) {
    return damaged("the file cannot be read");
  }
  ByteSource source(head);
  const auto opcode = static_cast<Opcode>(source.get<std::uint8_t>());
  const auto length = source.get<std::uint64_t>();
  if (length > left - head.size()) {
    return damaged("a record of " + std::to_string(length) + " bytes, but " +
                   std::to_string(left - head.size()) + " are left: the file was cut off");
  }
  if (opcode == Opcode::kDataEnd || opcode == Opcode::kFooter) {
    ended_ = true;
    return false;
  }
  if (is_read(opcode)) {
    if (length > kMost) return damaged("a record of more than 256 MiB");
    record_.resize(static_cast<std::size_t>(length));
    if (!file_.read(reinterpret_cast<char*>(record_.data()),
                    static_cast<std::streamsize>(length))) {
      return damaged("the file cannot be read");
    }
    if (opcode == Opcode::kMessage) {
      loose_.emplace();
      if (!use(opcode, record_, &*loose_)) {
        loose_.reset();
        return false;
      }
    } else if (!use(opcode, record_, nullptr)) {
      return false;
    }
  }
  at_ += head.size() + length;
  return true;
}

bool Reader::use(Opcode opcode, std::span<const std::byte> content, Message* message) {
  ByteSource source(content);
  switch (opcode) {
    case Opcode::kSchema: {
      Schema schema;
      schema.id = source.get<std::uint16_t>();
      schema.name = source.text();
      schema.encoding = source.text();
      schema.data = source.text();
      if (!source.good()) return damaged("a schema that is shorter than it says");
      schemas_.try_emplace(schema.id, std::move(schema));
      return true;
    }
    case Opcode::kChannel: {
      Channel channel;
      channel.id = source.get<std::uint16_t>();
      channel.schema = source.get<std::uint16_t>();
      channel.topic = source.text();
      channel.encoding = source.text();
      channel.metadata = source.texts();
      if (!source.good()) return damaged("a channel that is shorter than it says");
      channels_.try_emplace(channel.id, std::move(channel));
      return true;
    }
    case Opcode::kMessage: {
      message->channel = source.get<std::uint16_t>();
      message->sequence = source.get<std::uint32_t>();
      message->log_time_ns = source.get<std::uint64_t>();
      message->publish_time_ns = source.get<std::uint64_t>();
      message->data = source.rest();
      if (!source.good()) return damaged("a message that is shorter than its head");
      if (!channels_.contains(message->channel)) {
        return damaged("a message of channel " + std::to_string(message->channel) +
                       ", which nothing names");
      }
      return true;
    }
    case Opcode::kMetadata: {
      Metadata metadata;
      metadata.name = source.text();
      metadata.values = source.texts();
      if (!source.good()) return damaged("metadata that are shorter than they say");
      metadata_.push_back(std::move(metadata));
      return true;
    }
    case Opcode::kChunk:
      return open_chunk(content);
    default:
      return true;
  }
}

bool Reader::open_chunk(std::span<const std::byte> content) {
  ByteSource source(content);
  source.take(16);  // its times
  const auto size = source.get<std::uint64_t>();
  const auto expected_crc = source.get<std::uint32_t>();
  const std::string compression = source.text();
  const auto length = source.get<std::uint64_t>();
  const std::span<const std::byte> packed = source.take(length);
  if (!source.good()) return damaged("a chunk that is shorter than it says");
  if (size > kMost) return damaged("a chunk of more than 256 MiB");
  std::vector<std::byte> unpacked;
  if (compression == "zstd") {
    // What the frame says of itself is asked before memory is: a lie costs nothing.
    const unsigned long long stated = ZSTD_getFrameContentSize(packed.data(), packed.size());
    if (stated == size || stated == ZSTD_CONTENTSIZE_UNKNOWN) {
      unpacked.resize(static_cast<std::size_t>(size));
      const std::size_t got =
          ZSTD_decompress(unpacked.data(), unpacked.size(), packed.data(), packed.size());
      if (ZSTD_isError(got) != 0 || got != size) return damaged("a chunk that does not unpack");
    } else {
      return damaged("a chunk whose size is not the one it says");
    }
  } else if (compression.empty()) {
    if (packed.size() != size) return damaged("a chunk whose size is not the one it says");
    unpacked.assign(packed.begin(), packed.end());
  } else {
    return damaged("a chunk compressed with \"" + compression + "\"; zstd and none are read");
  }
  boost::crc_32_type crc;
  crc.process_bytes(unpacked.data(), unpacked.size());
  if (expected_crc != 0 && crc.checksum() != expected_crc) {
    return damaged("a chunk whose checksum does not hold");
  }
  chunk_ = std::move(unpacked);
  chunk_at_ = 0;
  return true;
}

}  // namespace suture::mcap
