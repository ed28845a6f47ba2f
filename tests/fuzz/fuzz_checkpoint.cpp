// SPDX-License-Identifier: GPL-3.0-or-later
// A checkpoint: its head and state, or a word why not. Each input is tried as it is, and with a
// checksum that holds, so that what lies behind it is reached. Its state is read into a value of
// all kinds: whatever can be read is written as the same bytes.
//
// Not tried is to restore a simulation from bytes that somebody forged: see
// server/checkpoints/checkpoint_file.hpp.
#include <algorithm>
#include <boost/crc.hpp>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <utility>

#include "archive/archive.hpp"
#include "checkpoints/checkpoint_file.hpp"
#include "support/temporary_folder.hpp"

namespace {

using namespace sutured;

struct Inner {
  bool flag = false;
  std::string text;
  std::optional<Eigen::Vector3d> place;
  void serialize(Archive& archive) { archive(flag, text, place); }
};
struct State {
  std::uint32_t number = 0;
  std::vector<Inner> inner;
  std::vector<std::vector<double>> ragged;
  Eigen::MatrixXd matrix;
  Eigen::Matrix<double, 3, Eigen::Dynamic> columns;
  std::array<std::pair<int, double>, 2> pairs{};
  std::vector<Eigen::Quaterniond> turns;
  void serialize(Archive& archive) {
    archive(number, inner, ragged, matrix, columns, pairs, turns);
  }
};

void read_state(std::span<const std::byte> bytes) {
  try {
    Archive in = Archive::reading(bytes);
    State state;
    in(state);
    std::vector<std::byte> written;
    Archive out = Archive::writing(
        written, in.keeps_caches() ? Archive::Caches::kKept : Archive::Caches::kLeftOut);
    out(state);
    if (written.size() != bytes.size() - in.left() ||
        !std::equal(written.begin(), written.end(), bytes.begin()))
      std::abort();
  } catch (const ArchiveError&) {
  }
}

void read_file(const std::string& path) {
  // Of whom it says that it is: else most inputs end there.
  checkpoints::Identity expected;
  try {
    expected = checkpoints::read_checkpoint_info(path).identity;
  } catch (const checkpoints::CheckpointError&) {
  }
  try {
    read_state(checkpoints::read_checkpoint(path, expected).state);
  } catch (const checkpoints::CheckpointError&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const sutured::testing::TemporaryFolder folder;
  std::string bytes(reinterpret_cast<const char*>(data), size);
  read_file(folder.write("as-it-is", bytes));
  boost::crc_optimal<64, 0x42F0E1EBA9EA3693U, ~std::uint64_t{0}, ~std::uint64_t{0}, true, true> crc;
  if (size >= 8) bytes.resize(size - 8);
  crc.process_bytes(bytes.data(), bytes.size());
  const std::uint64_t sum = crc.checksum();
  bytes.append(reinterpret_cast<const char*>(&sum), sizeof sum);
  read_file(folder.write("sealed", bytes));
  read_state(std::as_bytes(std::span(data, size)));
  return 0;
}
