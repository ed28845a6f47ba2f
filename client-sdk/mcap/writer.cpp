// SPDX-License-Identifier: Apache-2.0
#include "mcap/writer.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <boost/crc.hpp>
#include <cassert>
#include <cerrno>
#include <system_error>

namespace suture::mcap {
namespace {

constexpr std::size_t kChunkBytes = 768U << 10U;
constexpr int kCompressionLevel = 1;  // frames are floats: higher levels cost and gain nothing

std::uint32_t crc32(std::span<const std::byte> bytes) {
  boost::crc_32_type crc;
  crc.process_bytes(bytes.data(), bytes.size());
  return crc.checksum();
}

std::string text_of(int fault) { return std::generic_category().message(fault); }

}  // namespace

Writer::Writer(const std::string& path, Existing existing, std::string_view profile,
               std::string_view library)
    : path_(path) {
  const int how = existing == Existing::kRefuse ? O_EXCL : 0;
  file_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | O_NONBLOCK | how, 0644);
  if (file_ < 0) {
    if (errno == EEXIST) {
      throw Error(ErrorCode::kBadInput, path + ": exists",
                  "choose another name, or replace it with --force");
    }
    throw Error(ErrorCode::kBadInput, path + ": cannot be made: " + text_of(errno),
                "check the folder and its permissions");
  }
  struct stat kind {};
  if (fstat(file_, &kind) != 0 || !S_ISREG(kind.st_mode)) {
    ::close(file_);
    throw Error(ErrorCode::kBadInput, path + ": is not a regular file", "choose another name");
  }
  try {
    ByteSink sink(head_);
    sink.bytes(std::as_bytes(std::span(kMagic)));
    sink.record(Opcode::kHeader, [&] {
      sink.text(profile);
      sink.text(library);
    });
    size_ = head_.size();
    if (kind.st_size == 0) begin();
  } catch (...) {
    ::close(file_);
    throw;
  }
}

Writer::~Writer() {
  if (file_ >= 0) ::close(file_);
}

std::uint16_t Writer::add_schema(std::string_view name, std::string_view encoding,
                                 std::string_view data) {
  const auto id = static_cast<std::uint16_t>(schemas_.size() + 1);
  schemas_.push_back({id, std::string(name), std::string(encoding), std::string(data)});
  schema_in_file_.push_back(false);
  return id;
}

std::uint16_t Writer::add_channel(std::uint16_t schema, std::string_view topic,
                                  std::string_view encoding) {
  assert(schema >= 1 && schema <= schemas_.size());
  const auto id = static_cast<std::uint16_t>(channels_.size());
  channels_.push_back({{id, schema, std::string(topic), std::string(encoding), {}}, false, 0, {}});
  return id;
}

void Writer::put(ByteSink& sink, const Schema& schema) {
  sink.record(Opcode::kSchema, [&] {
    sink.put(schema.id);
    sink.text(schema.name);
    sink.text(schema.encoding);
    sink.text(schema.data);
  });
}

void Writer::put(ByteSink& sink, const Channel& channel) {
  sink.record(Opcode::kChannel, [&] {
    sink.put(channel.id);
    sink.put(channel.schema);
    sink.text(channel.topic);
    sink.text(channel.encoding);
    sink.texts(channel.metadata);
  });
}

void Writer::write(const Message& message) {
  assert(message.channel < channels_.size());
  ChannelState& state = channels_[message.channel];
  ByteSink sink(chunk_);
  if (chunk_.empty()) {
    chunk_begin_ns_ = message.log_time_ns;
    chunk_end_ns_ = message.log_time_ns;
  }
  if (!state.in_file) {
    const std::size_t schema = state.channel.schema - 1U;
    if (!schema_in_file_[schema]) put(sink, schemas_[schema]);
    put(sink, state.channel);
    schema_in_file_[schema] = state.in_file = true;
  }
  state.index.emplace_back(message.log_time_ns, chunk_.size());
  sink.record(Opcode::kMessage, [&] {
    sink.put(message.channel);
    sink.put(message.sequence);
    sink.put(message.log_time_ns);
    sink.put(message.publish_time_ns);
    sink.bytes(message.data);
  });
  ++state.count;
  chunk_begin_ns_ = std::min(chunk_begin_ns_, message.log_time_ns);
  chunk_end_ns_ = std::max(chunk_end_ns_, message.log_time_ns);
  begin_ns_ = message_count_ == 0 ? message.log_time_ns : std::min(begin_ns_, message.log_time_ns);
  end_ns_ = std::max(end_ns_, message.log_time_ns);
  ++message_count_;
  if (chunk_.size() >= kChunkBytes) flush();
}

void Writer::flush() {
  if (chunk_.empty()) return;
  compressed_.resize(ZSTD_compressBound(chunk_.size()));
  const std::size_t size = ZSTD_compress(compressed_.data(), compressed_.size(), chunk_.data(),
                                         chunk_.size(), kCompressionLevel);
  assert(ZSTD_isError(size) == 0);  // the bound is enough, and nothing else can fail
  compressed_.resize(size);

  ChunkInfo info{chunk_begin_ns_, chunk_end_ns_, size_, 0, {}, 0, size, chunk_.size()};
  out_.clear();
  ByteSink sink(out_);
  sink.record(Opcode::kChunk, [&] {
    sink.put(info.begin_ns);
    sink.put(info.end_ns);
    sink.put(info.uncompressed);
    sink.put(crc32(chunk_));
    sink.text("zstd");
    sink.put(info.compressed);
    sink.bytes(compressed_);
  });
  info.length = out_.size();
  for (ChannelState& state : channels_) {
    if (state.index.empty()) continue;
    info.index_at.emplace_back(state.channel.id, info.at + out_.size());
    sink.record(Opcode::kMessageIndex, [&] {
      sink.put(state.channel.id);
      sink.put(static_cast<std::uint32_t>(state.index.size() * 16));
      for (const auto& [time_ns, offset] : state.index) {
        sink.put(time_ns);
        sink.put(offset);
      }
    });
    state.index.clear();
  }
  info.index_length = out_.size() - info.length;
  chunk_.clear();
  append(out_);
  chunks_.push_back(std::move(info));
}

void Writer::write(const Metadata& metadata) {
  flush();
  out_.clear();
  ByteSink sink(out_);
  sink.record(Opcode::kMetadata, [&] {
    sink.text(metadata.name);
    sink.texts(metadata.values);
  });
  const std::uint64_t at = size_;
  append(out_);
  metadata_.push_back({at, out_.size(), metadata.name});
}

void Writer::put_statistics(ByteSink& sink) const {
  sink.record(Opcode::kStatistics, [&] {
    const auto used = [](const auto& list, auto in_file) {
      return std::count_if(list.begin(), list.end(), in_file);
    };
    const auto channels = used(channels_, [](const ChannelState& state) { return state.in_file; });
    sink.put(message_count_);
    sink.put(
        static_cast<std::uint16_t>(used(schema_in_file_, [](bool in_file) { return in_file; })));
    sink.put(static_cast<std::uint32_t>(channels));
    sink.put(std::uint32_t{0});  // attachments
    sink.put(static_cast<std::uint32_t>(metadata_.size()));
    sink.put(static_cast<std::uint32_t>(chunks_.size()));
    sink.put(begin_ns_);
    sink.put(end_ns_);
    sink.put(static_cast<std::uint32_t>(channels * 10));
    for (const ChannelState& state : channels_) {
      if (!state.in_file) continue;
      sink.put(state.channel.id);
      sink.put(state.count);
    }
  });
}

void Writer::put_chunk_index(ByteSink& sink, const ChunkInfo& chunk) const {
  sink.record(Opcode::kChunkIndex, [&] {
    sink.put(chunk.begin_ns);
    sink.put(chunk.end_ns);
    sink.put(chunk.at);
    sink.put(chunk.length);
    sink.put(static_cast<std::uint32_t>(chunk.index_at.size() * 10));
    for (const auto& [channel, at] : chunk.index_at) {
      sink.put(channel);
      sink.put(at);
    }
    sink.put(chunk.index_length);
    sink.text("zstd");
    sink.put(chunk.compressed);
    sink.put(chunk.uncompressed);
  });
}

void Writer::finish() {
  if (file_ < 0) return;
  flush();
  out_.clear();
  ByteSink sink(out_);
  sink.record(Opcode::kDataEnd, [&] { sink.put(std::uint32_t{0}); });  // each chunk has its own CRC
  const std::size_t summary = out_.size();
  struct Group {
    Opcode opcode;
    std::size_t begin, end;
  };
  std::vector<Group> groups;
  const auto group = [&](Opcode opcode, auto&& fill) {
    const std::size_t begin = out_.size();
    fill();
    if (out_.size() > begin) groups.push_back({opcode, begin, out_.size()});
  };
  group(Opcode::kSchema, [&] {
    for (std::size_t i = 0; i < schemas_.size(); ++i)
      if (schema_in_file_[i]) put(sink, schemas_[i]);
  });
  group(Opcode::kChannel, [&] {
    for (const ChannelState& state : channels_)
      if (state.in_file) put(sink, state.channel);
  });
  group(Opcode::kStatistics, [&] { put_statistics(sink); });
  group(Opcode::kChunkIndex, [&] {
    for (const ChunkInfo& chunk : chunks_) put_chunk_index(sink, chunk);
  });
  group(Opcode::kMetadataIndex, [&] {
    for (const MetadataInfo& metadata : metadata_) {
      sink.record(Opcode::kMetadataIndex, [&] {
        sink.put(metadata.at);
        sink.put(metadata.length);
        sink.text(metadata.name);
      });
    }
  });
  const std::size_t offsets = out_.size();
  for (const Group& part : groups) {
    sink.record(Opcode::kSummaryOffset, [&] {
      sink.put(part.opcode);
      sink.put(size_ + part.begin);
      sink.put(std::uint64_t{part.end - part.begin});
    });
  }
  // The checksum covers the summary and the footer as far as the checksum itself.
  constexpr std::uint64_t kFooterBytes = 20;
  sink.put(Opcode::kFooter);
  sink.put(kFooterBytes);
  sink.put(size_ + summary);
  sink.put(size_ + offsets);
  sink.put(crc32(std::span(out_).subspan(summary)));
  sink.bytes(std::as_bytes(std::span(kMagic)));
  append(out_);
  if (fdatasync(file_) != 0) fail(errno);
  const int file = std::exchange(file_, -1);
  if (::close(file) != 0) fail(errno);
}

void Writer::begin() {
  if (ftruncate(file_, 0) != 0) fail(errno);
  size_ = 0;
  const std::vector<std::byte> head = std::exchange(head_, {});
  append(head);
}

void Writer::append(std::span<const std::byte> bytes) {
  if (!failure_.empty()) fail(0);
  if (replaces()) begin();
  std::span<const std::byte> left = bytes;
  while (!left.empty()) {
    const ssize_t written = ::write(file_, left.data(), left.size());
    if (written < 0) {
      if (errno == EINTR) continue;
      fail(errno);
    }
    left = left.subspan(static_cast<std::size_t>(written));
  }
  size_ += bytes.size();
}

void Writer::fail(int fault) {
  if (failure_.empty()) {
    failure_ = text_of(fault);
    // Nothing half-written stays; where that fails as well, a reader finds the cut itself.
    if (file_ >= 0 && !replaces() && ftruncate(file_, static_cast<off_t>(size_)) != 0) errno = 0;
  }
  throw Error(ErrorCode::kBadInput, path_ + ": cannot be written: " + failure_,
              "make room; what was written until then can be read");
}

}  // namespace suture::mcap
