// SPDX-License-Identifier: GPL-3.0-or-later
#include "archive/archive.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace sutured {
namespace {

enum class Colour : std::uint8_t { kRed, kBlue };

struct Inner {
  bool yes = false;
  Colour colour = Colour::kRed;
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
};

using Bounded = Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::ColMajor, 8, 6>;

struct Everything {
  std::int32_t number = 0;
  double special = 0.0;
  std::string text;
  std::vector<double> plain;
  std::vector<Inner> inner;
  std::array<double, 2> two{};
  std::vector<std::pair<std::uint64_t, std::string>> named;
  Bounded matrix;
};

class Counter {
 public:
  explicit Counter(int count) : count_(count) {}
  void serialize(Archive& archive) {
    auto& [count, scratch] = *this;
    archive(count);
  }
  [[nodiscard]] int count() const { return count_; }

 private:
  int count_ = 0;
  double scratch_ = 0.0;
};

Everything example() {
  Everything e;
  e.number = -7;
  e.special = -std::numeric_limits<double>::infinity();
  e.text = std::string("a\0b", 3);
  e.plain = {1.0, -0.0, 5e-324};
  e.inner = {{true, Colour::kBlue, {1, 2, 3}, {0.1, 0.2, 0.3, 0.4}}, {}};
  e.two = {1.0, 2.0};
  e.named = {{99, "name"}};
  e.matrix = Bounded::Constant(5, 6, 0.25);
  return e;
}

template <class T>
std::vector<std::byte> written(T value) {
  std::vector<std::byte> bytes;
  Archive archive = Archive::writing(bytes, Archive::Caches::kKept);
  archive(value);
  return bytes;
}

TEST(Archive, ReadsWhatItWrote) {
  const std::vector<std::byte> bytes = written(example());
  Everything read;
  Archive archive = Archive::reading(bytes);
  archive(read);
  archive.expect_end();
  EXPECT_EQ(read.text.size(), 3U);
  EXPECT_EQ(read.inner[0].q.z(), 0.4);
  EXPECT_EQ(read.inner[0].colour, Colour::kBlue);
  EXPECT_EQ(read.matrix.rows(), 5);
  EXPECT_TRUE(std::signbit(read.plain[1]));
  EXPECT_EQ(written(read), bytes);
}

TEST(Archive, KeepsWhetherThereIsAValue) {
  const auto some = written(std::optional<Inner>(example().inner[0]));
  const auto none = written(std::optional<Inner>());
  std::optional<Inner> read;
  Archive first = Archive::reading(some);
  first(read);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->x.z(), 3.0);
  Archive second = Archive::reading(none);
  second(read);
  EXPECT_FALSE(read);
}

TEST(Archive, AClassNamesItsFieldsOnce) {
  const auto bytes = written(Counter(3));
  Counter counter(0);
  Archive archive = Archive::reading(bytes);
  archive(counter);
  EXPECT_EQ(counter.count(), 3);
}

TEST(Archive, EverythingThatEndsEarlyIsRefused) {
  const auto bytes = written(example());
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    Everything read;
    EXPECT_THROW(
        {
          Archive archive = Archive::reading(std::span(bytes).first(size));
          archive(read);
        },
        ArchiveError)
        << size;
  }
}

TEST(Archive, ALengthThatLiesDoesNotFillTheMemory) {
  auto bytes = written(std::vector<double>{1.0});
  for (std::size_t i = 1; i < 8; ++i) bytes[i] = std::byte{0xff};
  std::vector<double> read;
  Archive archive = Archive::reading(bytes);
  EXPECT_THROW(archive(read), ArchiveError);
  EXPECT_TRUE(read.empty());
}

TEST(Archive, AMatrixWhoseSizesLieDoesNotFillTheMemory) {
  const auto bytes = written(Eigen::MatrixXd(Eigen::MatrixXd::Zero(8, 8)));
  for (const std::uint8_t size : {std::uint8_t{9}, std::uint8_t{200}}) {
    auto lies = bytes;  // each size alone could be: so many bytes are there
    lies[1] = lies[9] = std::byte{size};
    Eigen::MatrixXd read;
    Archive archive = Archive::reading(lies);
    EXPECT_THROW(archive(read), ArchiveError);
    if (size == 200) {
      EXPECT_EQ(read.size(), 0);
    }
  }
}

TEST(Archive, RefusesWhatCannotBeAValue) {
  auto truth = written(true);
  truth.back() = std::byte{2};
  bool read = false;
  Archive first = Archive::reading(truth);
  EXPECT_THROW(first(read), ArchiveError);

  Eigen::Matrix<double, Eigen::Dynamic, 6> tall = Eigen::Matrix<double, 9, 6>::Zero();
  const auto too_tall = written(tall);
  Bounded bounded;
  Archive second = Archive::reading(too_tall);
  EXPECT_THROW(second(bounded), ArchiveError);

  const auto two = written(std::vector<int>{1, 2});
  std::vector<int> three(3);
  Archive third = Archive::reading(two);
  EXPECT_THROW(third.fixed(three), ArchiveError);
  EXPECT_THROW(third.expect_end(), ArchiveError);

  EXPECT_THROW((void)Archive::reading({}), ArchiveError);
  const std::array<std::byte, 1> nonsense{std::byte{7}};
  EXPECT_THROW((void)Archive::reading(nonsense), ArchiveError);
}

}  // namespace
}  // namespace sutured
