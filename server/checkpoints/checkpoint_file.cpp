// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_file.hpp"

#include <algorithm>
#include <array>
#include <boost/crc.hpp>
#include <fstream>
#include <system_error>

#include "archive/archive.hpp"
#include "geometry/regular_file.hpp"
#include "protocol/whole_file.hpp"
#include "scene/scene.hpp"

namespace sutured::checkpoints {
namespace {

constexpr std::array<char, 8> kMagic{'S', 'U', 'T', 'C', 'K', 'P', 'T', '\n'};
constexpr std::uint64_t kBytesMax = std::uint64_t{8} << 30;
// The head of a file: names are short.
constexpr std::size_t kHeadMax = 65536;

// CRC-64/XZ.
using Crc =
    boost::crc_optimal<64, 0x42F0E1EBA9EA3693U, ~std::uint64_t{0}, ~std::uint64_t{0}, true, true>;

std::uint64_t checksum(std::span<const std::byte> bytes) {
  Crc crc;
  crc.process_bytes(bytes.data(), bytes.size());
  return crc.checksum();
}

[[noreturn]] void fail(const std::filesystem::path& path, const std::string& what,
                       const std::string& mend) {
  throw CheckpointError(path.string() + ": " + what + "; " + mend);
}

struct Head {
  std::array<char, 8> magic = kMagic;
  std::uint32_t version = kVersion;
  CheckpointInfo info;
  std::uint64_t length = 0;
};

/// Reads a head and returns where the state begins.
std::size_t read_head(const std::filesystem::path& path, std::span<const std::byte> bytes,
                      Head& head) {
  constexpr const char* kOther = "use another checkpoint";
  try {
    if (bytes.size() < kMagic.size() ||
        !std::equal(kMagic.begin(), kMagic.end(), bytes.begin(),
                    [](char c, std::byte b) { return static_cast<std::byte>(c) == b; }))
      fail(path, "is no checkpoint", kOther);
    Archive archive = Archive::reading(bytes.subspan(kMagic.size()));
    archive(head.version);
    if (head.version != kVersion)
      fail(path,
           "was written in version " + std::to_string(head.version) +
               " of the format, and this program reads version " + std::to_string(kVersion),
           kOther);
    archive(head.info, head.length);
    return bytes.size() - archive.left();
  } catch (const ArchiveError&) {
    fail(path, "is damaged: its head is cut off or makes no sense", kOther);
  }
}

/// Refuses a file of `size` bytes whose state begins at `first`, and is not as long as the head
/// says: behind it stands the checksum alone.
void expect_length(const std::filesystem::path& path, std::uint64_t size, std::uint64_t first,
                   const Head& head) {
  constexpr std::uint64_t kSumBytes = sizeof(std::uint64_t);
  if (size - first < kSumBytes || size - first - kSumBytes != head.length)
    fail(path, "is damaged: it is not as long as it says", "use another checkpoint");
}

}  // namespace

Identity identity_of(const scene::Scene& scene, Writer writer) {
  scene::Scene content = scene;
  // Where its files lie, and what a reader should know of them, make no other scene.
  auto& [name, path, rate_hz, gravity, tissues, needles, threads, tools, wounds, contact, notes] =
      content;
  for (scene::Tissue& tissue : tissues) tissue.mesh_path.clear();
  std::vector<std::byte> bytes;
  Archive archive = Archive::writing(bytes, Archive::Caches::kLeftOut);
  archive(name, rate_hz, gravity, tissues, needles, threads, tools, contact);
  for (auto& [wound, edges] : wounds) archive(wound, edges);  // GCC 12 counts no fields here
  return {writer, checksum(bytes), scene.name, SUTURED_VERSION};
}

void expect_same(const std::filesystem::path& path, const Identity& found,
                 const Identity& expected) {
  if (found.writer != expected.writer)
    fail(path,
         found.writer == Writer::kRun ? "was written by `sutured run`, which keeps more and less"
                                      : "was written by `sutured serve`: it has no record of a run",
         "use it there");
  if (found.build != expected.build)
    fail(path, "was written by sutured " + found.build + ", and this is " + expected.build,
         "begin anew, or go back to that version");
  if (found.scene != expected.scene)
    fail(path,
         found.scene_name == expected.scene_name
             ? "is of scene \"" + found.scene_name + "\" as it was before it or a mesh was changed"
             : "is of scene \"" + found.scene_name + "\", and this is \"" + expected.scene_name +
                   "\"",
         "use a checkpoint of this scene");
}

void write_checkpoint(const std::filesystem::path& path, const CheckpointInfo& info,
                      std::span<const std::byte> state) {
  Head head;
  head.info = info;
  head.length = state.size();
  std::vector<std::byte> before;
  for (const char c : head.magic) before.push_back(static_cast<std::byte>(c));
  Archive archive = Archive::writing(before, Archive::Caches::kLeftOut);
  archive(head.version, head.info, head.length);
  Crc crc;
  crc.process_bytes(before.data(), before.size());
  crc.process_bytes(state.data(), state.size());
  const std::uint64_t sum = crc.checksum();

  try {
    suture::WholeFile file(path, 0600);
    file.write(before);
    file.write(state);
    file.write(std::as_bytes(std::span(&sum, 1)));
    file.commit();
  } catch (const std::system_error& error) {
    throw CheckpointError(std::string(error.what()) + "; see to the folder and the disk's space");
  }
}

Checkpoint read_checkpoint(const std::filesystem::path& path, const Identity& expected) {
  std::string content;
  Head head;
  try {
    // Whatever else it may be is not read to its end.
    const geometry::FileHead begin = geometry::read_regular_file_head(path.string(), kHeadMax);
    const std::size_t before = read_head(path, std::as_bytes(std::span(begin.bytes)), head);
    expect_length(path, begin.size, before, head);
    content = geometry::read_regular_file(path.string(), kBytesMax);
  } catch (const geometry::FileError& error) {
    fail(path, error.what(), "see whether the name is right");
  }
  const auto bytes = std::as_bytes(std::span(content));
  const std::size_t first = read_head(path, bytes, head);
  std::uint64_t sum = 0;
  expect_length(path, bytes.size(), first, head);
  const auto end = bytes.subspan(first + head.length);
  std::copy(end.begin(), end.end(), std::as_writable_bytes(std::span(&sum, 1)).begin());
  if (checksum(bytes.first(first + head.length)) != sum)
    fail(path, "is damaged: its checksum is wrong", "use another checkpoint");
  expect_same(path, head.info.identity, expected);
  const auto state = bytes.subspan(first, head.length);
  return {head.info, {state.begin(), state.end()}};
}

CheckpointInfo read_checkpoint_info(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::array<char, kHeadMax> content{};
  file.read(content.data(), content.size());
  Head head;
  (void)read_head(
      path, std::as_bytes(std::span(content)).first(static_cast<std::size_t>(file.gcount())), head);
  return head.info;
}

}  // namespace sutured::checkpoints
