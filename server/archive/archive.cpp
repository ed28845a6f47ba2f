// SPDX-License-Identifier: GPL-3.0-or-later
#include "archive/archive.hpp"

#include <cstring>

namespace sutured {

Archive Archive::writing(std::vector<std::byte>& bytes, Caches caches) {
  Archive archive;
  archive.out_ = &bytes;
  archive.caches_ = caches;
  archive(archive.caches_);
  return archive;
}

Archive Archive::reading(std::span<const std::byte> bytes) {
  Archive archive;
  archive.in_ = bytes;
  archive(archive.caches_);
  if (archive.caches_ > Caches::kKept) throw ArchiveError("it begins with what is no state");
  return archive;
}

void Archive::bytes(void* data, std::size_t size) {
  if (size == 0) return;
  if (out_ != nullptr) {
    const auto* first = static_cast<const std::byte*>(data);
    out_->insert(out_->end(), first, first + size);
    return;
  }
  if (size > in_.size()) throw ArchiveError("it ends early");
  std::memcpy(data, in_.data(), size);
  in_ = in_.subspan(size);
}

std::size_t Archive::length(std::size_t size) {
  std::uint64_t count = size;
  value(count);
  // No element is written in less than a byte: a length that lies does not fill the memory.
  if (reads() && count > in_.size()) throw ArchiveError("it ends early");
  return count;
}

void Archive::value(bool& v) {
  std::uint8_t byte = v ? 1 : 0;
  value(byte);
  if (byte > 1) throw ArchiveError("neither true nor false");
  v = byte == 1;
}

void Archive::value(std::string& v) {
  v.resize(length(v.size()));
  bytes(v.data(), v.size());
}

void Archive::expect_end() const {
  if (!in_.empty()) throw ArchiveError("it is longer than its state");
}

}  // namespace sutured
