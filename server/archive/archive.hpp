// SPDX-License-Identifier: GPL-3.0-or-later
// State to bytes and back, by one list of fields for both ways.
//
// A class has one member `serialize(Archive&)`, which names its fields once: writing, the archive
// reads them; reading, it fills them. So the two ways cannot differ. That no field is forgotten is
// the compiler's business:
//
//   aggregates   have no list at all: Boost.PFR walks their fields (GCC 12 breaks down over those
//                that hold an array of what has a destructor: they need a list)
//   classes      bind all of their members by a structured binding, which does not compile once a
//                member is added; what is not archived is seen to be left out
//
//     void serialize(Archive& archive) {
//       auto& [scene, pose, held, scratch] = *this;   // scene: given; scratch: of one call
//       archive(pose, held);
//     }
//
// Bytes are little endian and without padding; sequences begin with their length (64 bit).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <bit>
#include <boost/pfr/core.hpp>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace sutured {

/// The bytes are not those of the state they are read into.
struct ArchiveError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Writes state to a buffer, or reads it from one.
///
/// Thread: one at a time. Allocates: where the buffer, or what is read, outgrows its memory.
class Archive {
 public:
  /// What follows from the rest of the state up to rounding: columns of K⁻¹ that were walked, pairs
  /// that were looked for. With it a simulation goes on to the bit; without it the state is
  /// smaller, the more so the larger the mesh (docs/adr/0040).
  enum class Caches : std::uint8_t { kLeftOut, kKept };

  /// Returns an archive that appends to `bytes`, which outlives it.
  [[nodiscard]] static Archive writing(std::vector<std::byte>& bytes, Caches caches);
  /// Returns an archive that reads `bytes`, which outlive it. Throws ArchiveError.
  [[nodiscard]] static Archive reading(std::span<const std::byte> bytes);

  [[nodiscard]] bool reads() const { return out_ == nullptr; }
  [[nodiscard]] bool keeps_caches() const { return caches_ == Caches::kKept; }

  /// Writes the values in order, or reads them. Throws ArchiveError where bytes are missing or
  /// cannot be such a value; what came before is then read.
  template <class... T>
  void operator()(T&... values) {
    (value(values), ...);
  }

  /// Archives a vector whose length is given by the scene. Throws ArchiveError where another one
  /// was written.
  template <class T>
  void fixed(std::vector<T>& values) {
    const std::size_t expected = values.size();
    if (length(expected) != expected) throw ArchiveError("it is of another scene");
    elements(values.data(), expected);
  }

  /// Returns how many bytes are still to be read.
  [[nodiscard]] std::size_t left() const { return in_.size(); }
  /// Throws ArchiveError unless all bytes were read.
  void expect_end() const;

 private:
  Archive() = default;
  /// Copies `size` bytes out of or into `data`.
  void bytes(void* data, std::size_t size);
  /// Writes the length of a sequence, or reads one that the bytes left can hold.
  [[nodiscard]] std::size_t length(std::size_t size);

  template <class T>
  static constexpr bool is_plain =
      (std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) || std::is_enum_v<T>;

  template <class T>
  void elements(T* first, std::size_t count) {
    if constexpr (is_plain<T>) {
      bytes(first, count * sizeof(T));
    } else {
      for (std::size_t i = 0; i < count; ++i) value(first[i]);
    }
  }

  template <class T>
  void value(T& v) {
    static_assert(std::endian::native == std::endian::little);
    if constexpr (requires { v.serialize(*this); }) {
      v.serialize(*this);
    } else if constexpr (is_plain<T>) {
      bytes(&v, sizeof v);
    } else {
      static_assert(std::is_aggregate_v<T>, "give it a member serialize(Archive&)");
      boost::pfr::for_each_field(v, [this](auto& field) { this->value(field); });
    }
  }
  void value(bool& v);
  void value(std::string& v);
  void value(Eigen::Quaterniond& v) { value(v.coeffs()); }
  template <class T>
  void value(std::vector<T>& v) {
    static_assert(!std::is_same_v<T, bool>);
    const std::size_t count = length(v.size());
    if (reads()) v.resize(count);
    elements(v.data(), count);
  }
  template <class T, std::size_t N>
  void value(std::array<T, N>& v) {
    elements(v.data(), N);
  }
  template <class A, class B>
  void value(std::pair<A, B>& v) {
    value(v.first);
    value(v.second);
  }
  template <class T>
  void value(std::optional<T>& v) {
    bool present = v.has_value();
    value(present);
    if (!present) v.reset();
    if (present && !v) v.emplace();
    if (present) value(*v);
  }
  template <class Scalar, int Rows, int Columns, int Order, int RowsMax, int ColumnsMax>
  void value(Eigen::Matrix<Scalar, Rows, Columns, Order, RowsMax, ColumnsMax>& v) {
    if constexpr (Rows == Eigen::Dynamic || Columns == Eigen::Dynamic) {
      const auto dimension = [this](Eigen::Index present, int fixed_size, int max) {
        const std::size_t size = length(static_cast<std::size_t>(present));
        if ((fixed_size != Eigen::Dynamic && size != static_cast<std::size_t>(fixed_size)) ||
            (max != Eigen::Dynamic && size > static_cast<std::size_t>(max)))
          throw ArchiveError("a matrix is not of its size");
        return static_cast<Eigen::Index>(size);
      };
      const Eigen::Index rows = dimension(v.rows(), Rows, RowsMax);
      const Eigen::Index columns = dimension(v.cols(), Columns, ColumnsMax);
      if (reads()) {
        // Two lengths that the bytes can hold, and a product that they cannot.
        if (columns > 0 &&
            static_cast<std::size_t>(rows) > left() / static_cast<std::size_t>(columns))
          throw ArchiveError("it ends early");
        v.resize(rows, columns);
      }
    }
    elements(v.data(), static_cast<std::size_t>(v.size()));
  }

  std::vector<std::byte>* out_ = nullptr;
  std::span<const std::byte> in_;  ///< what is still to be read
  Caches caches_ = Caches::kLeftOut;
};

}  // namespace sutured
