// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "mcap/records.hpp"
#include "suture/error.hpp"

namespace suture::mcap {

/// Writes an MCAP file front to back: messages gather in a chunk, which is compressed (zstd)
/// and written with its indexes when it holds 768 KiB, or at `flush`; `finish` closes the
/// file with a summary. What a written chunk holds can be read whatever happens after,
/// other than to the machine: the file is given to the kernel, not forced to the disk.
///
/// Where the disk refuses, the file is cut back to its last whole chunk, the call throws
/// Error kBadInput, and so does every later one that would write.
/// Threads: one at a time. Memory: one chunk, its compressed form, and 40 bytes a chunk and
/// channel for the summary.
class Writer {
 public:
  enum class Existing { kRefuse, kReplace };

  /// Makes the file; one that it replaces stays until something is written. Throws Error kBadInput
  /// where it exists and shall not be replaced, is no regular file, or cannot be made. `profile`
  /// and `library` stand in its header.
  Writer(const std::string& path, Existing existing, std::string_view profile,
         std::string_view library);
  /// Leaves the file as it is: without `finish`, one that was cut off.
  ~Writer();
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Returns the schema's id. It reaches the file with the first message that needs it.
  std::uint16_t add_schema(std::string_view name, std::string_view encoding, std::string_view data);
  /// Returns the channel's id; `schema` is an id that `add_schema` returned.
  std::uint16_t add_channel(std::uint16_t schema, std::string_view topic,
                            std::string_view encoding);
  /// Adds a message to the present chunk. `message.channel` is an id that `add_channel` returned.
  void write(const Message& message);
  /// Writes a metadata record, after what was added before it.
  void write(const Metadata& metadata);
  /// Writes the present chunk, where it holds anything.
  void flush();
  /// Writes the summary, hands the file to the disk and closes it.
  void finish();

  [[nodiscard]] std::uint64_t message_count() const noexcept { return message_count_; }
  /// Returns whether what the file held before is still there.
  [[nodiscard]] bool replaces() const noexcept { return !head_.empty(); }
  /// Returns the length of the file so far.
  [[nodiscard]] std::uint64_t size_bytes() const noexcept { return size_; }
  /// Returns whether the present chunk holds messages.
  [[nodiscard]] bool pending() const noexcept { return !chunk_.empty(); }

 private:
  struct ChannelState {
    Channel channel;
    bool in_file = false;
    std::uint64_t count = 0;
    std::vector<std::pair<std::uint64_t, std::uint64_t>> index;  // log time, offset in the chunk
  };
  struct ChunkInfo {
    std::uint64_t begin_ns, end_ns, at, length;
    std::vector<std::pair<std::uint16_t, std::uint64_t>> index_at;
    std::uint64_t index_length, compressed, uncompressed;
  };
  struct MetadataInfo {
    std::uint64_t at, length;
    std::string name;
  };

  void begin();
  void append(std::span<const std::byte> bytes);
  [[noreturn]] void fail(int fault);
  static void put(ByteSink& sink, const Schema& schema);
  static void put(ByteSink& sink, const Channel& channel);
  void put_statistics(ByteSink& sink) const;
  void put_chunk_index(ByteSink& sink, const ChunkInfo& chunk) const;

  std::string path_;
  int file_ = -1;
  std::uint64_t size_ = 0;
  std::string failure_;  // why the disk refused; empty: it did not
  std::vector<Schema> schemas_;
  std::vector<bool> schema_in_file_;
  std::vector<ChannelState> channels_;
  std::vector<ChunkInfo> chunks_;
  std::vector<MetadataInfo> metadata_;
  std::vector<std::byte> head_;  // what the file begins with, until it is written
  std::vector<std::byte> chunk_, compressed_, out_;
  std::uint64_t chunk_begin_ns_ = 0, chunk_end_ns_ = 0;
  std::uint64_t message_count_ = 0, begin_ns_ = 0, end_ns_ = 0;
};

}  // namespace suture::mcap
