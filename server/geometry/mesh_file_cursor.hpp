// SPDX-License-Identifier: GPL-3.0-or-later
// Private to mesh_file_guard.cpp: a reader of words, lines and raw values that trusts nothing.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "geometry/mesh_error.hpp"

namespace sutured::geometry {

// Words and names in meshes end nowhere near these; libgmsh's own buffers end at 256.
inline constexpr std::size_t kWordMax = 64;
inline constexpr std::size_t kLineMax = 250;

// A word of an unknown file, fit to be printed.
inline std::string printable(std::string_view word) {
  std::string text = "\"";
  for (const char c : word.substr(0, 32)) text += c >= 0x20 && c < 0x7f ? c : '?';
  return text + (word.size() > 32 ? "…\"" : "\"");
}

// Reads a file from the front: words and lines where it is text, raw values where it is binary.
class Cursor {
 public:
  Cursor(const std::string& path, std::string_view bytes) : path_(path), bytes_(bytes) {}

  bool binary = false;
  bool big_endian = false;

  [[nodiscard]] std::size_t position() const { return at_; }
  [[nodiscard]] std::size_t remaining() const { return bytes_.size() - at_; }
  [[nodiscard]] std::string_view since(std::size_t start) const {
    return bytes_.substr(start, at_ - start);
  }
  [[nodiscard]] int line() const {
    // The position stands behind the word a fault is about, which may end its line.
    const std::size_t end = std::min(at_ > 0 ? at_ - 1 : 0, bytes_.size());
    return binary
               ? 0
               : 1 + static_cast<int>(std::count(
                         bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(end), '\n'));
  }
  [[noreturn]] void fail(std::string what, std::string mend = kMendExport,
                         std::string entity = "") const {
    if (binary) what += " (byte " + std::to_string(at_) + ")";
    throw MeshError(path_, {{line(), std::move(entity), std::move(what), std::move(mend)}});
  }

  void skip_space() {
    while (at_ < bytes_.size() && is_space(bytes_[at_])) ++at_;
  }
  [[nodiscard]] bool at_end() {
    skip_space();
    return at_ == bytes_.size();
  }
  std::string_view word(const char* of) {
    skip_space();
    const std::size_t start = at_;
    while (at_ < bytes_.size() && !is_space(bytes_[at_]) && at_ - start <= kWordMax) ++at_;
    if (at_ == start)
      fail(std::string("the file ends where ") + of + " should stand", "was it cut short?");
    if (at_ - start > kWordMax) fail(std::string("a word too long for ") + of);
    return since(start);
  }
  [[nodiscard]] std::string_view peek_word() {
    skip_space();
    std::size_t end = at_;
    while (end < bytes_.size() && !is_space(bytes_[end]) && end - at_ <= kWordMax) ++end;
    return bytes_.substr(at_, end - at_);
  }
  // The rest of the line, without its end.
  std::string_view line_rest() {
    const std::size_t start = at_;
    while (at_ < bytes_.size() && bytes_[at_] != '\n') ++at_;
    std::string_view rest = since(start);
    if (at_ < bytes_.size()) ++at_;
    if (!rest.empty() && rest.back() == '\r') rest.remove_suffix(1);
    return rest;
  }
  void expect(std::string_view keyword) {
    const std::string_view found = word(std::string(keyword).c_str());
    if (found != keyword)
      fail("found " + printable(found) + " where " + std::string(keyword) + " should stand");
  }
  // The line must end here: binary values start right behind.
  void end_line() {
    const std::string_view rest = line_rest();
    if (rest.find_first_not_of(" \t") != std::string_view::npos)
      fail("found " + printable(rest) + " where the line should end");
  }

  // An integer: a word in text, a `Stored` in binary.
  template <typename Stored>
  std::int64_t integer(const char* of) {
    return binary ? static_cast<std::int64_t>(raw<Stored>(of)) : text_integer(of);
  }
  std::int64_t text_integer(const char* of) {
    const std::string_view text = word(of);
    std::int64_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size())
      fail("found " + printable(text) + " where " + of + " should stand, an integer");
    return value;
  }
  template <typename Stored = double>
  double real(const char* of) {
    if (binary) return static_cast<double>(raw<Stored>(of));
    std::string_view text = word(of);
    const std::string_view whole = text;
    if (text.starts_with('+')) text.remove_prefix(1);
    double value = 0.0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error == std::errc::result_out_of_range) return std::numeric_limits<double>::infinity();
    if (error != std::errc() || end != text.data() + text.size())
      fail("found " + printable(whole) + " where " + of + " should stand, a number");
    return value;
  }
  // How many of something follow, each at least `bytes_each` long: so none can be claimed that
  // are not there.
  template <typename Stored>
  std::size_t count(const char* of, std::size_t bytes_each) {
    return checked_count(integer<Stored>(of), of, bytes_each);
  }
  std::size_t text_count(const char* of, std::size_t bytes_each) {
    return checked_count(text_integer(of), of, bytes_each);
  }

 private:
  static bool is_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

  std::size_t checked_count(std::int64_t n, const char* of, std::size_t bytes_each) const {
    if (n < 0 || static_cast<std::uint64_t>(n) > remaining() / bytes_each)
      fail(std::string(of) + " is " + std::to_string(n) + ", but " + std::to_string(remaining()) +
               " bytes are left",
           "was the file cut short?");
    return static_cast<std::size_t>(n);
  }
  template <typename Stored>
  Stored raw(const char* of) {
    if (remaining() < sizeof(Stored))
      fail(std::string("the file ends where ") + of + " should stand", "was it cut short?");
    std::array<char, sizeof(Stored)> buffer;
    std::memcpy(buffer.data(), bytes_.data() + at_, sizeof(Stored));
    if (big_endian != (std::endian::native == std::endian::big))
      std::reverse(buffer.begin(), buffer.end());
    at_ += sizeof(Stored);
    return std::bit_cast<Stored>(buffer);
  }

  const std::string& path_;
  std::string_view bytes_;
  std::size_t at_ = 0;
};

}  // namespace sutured::geometry
