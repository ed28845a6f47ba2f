// SPDX-License-Identifier: GPL-3.0-or-later
// Private to this folder: reads a TOML table key by key and collects what is wrong with it.
#pragma once

#include <Eigen/Geometry>
#include <limits>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#define TOML_HEADER_ONLY 0
#include <toml++/toml.h>

#include "scene/scene.hpp"
#include "scene/scene_error.hpp"

namespace sutured::scene {

/// What is wrong with one scene file, in the order found.
class Faults {
 public:
  explicit Faults(std::string file) : file_(std::move(file)) {}

  void add(const toml::source_region& place, std::string what, std::string mend) {
    list_.push_back({file_, static_cast<int>(place.begin.line),
                     static_cast<int>(place.begin.column), std::move(what), std::move(mend)});
  }
  void add(SceneFault fault) { list_.push_back(std::move(fault)); }
  [[nodiscard]] bool empty() const { return list_.empty(); }
  [[nodiscard]] std::size_t count() const { return list_.size(); }
  [[nodiscard]] std::size_t size() const { return list_.size(); }
  /// Returns the faults by line, those of other files last.
  [[nodiscard]] std::vector<SceneFault> sorted() const;

 private:
  std::string file_;
  std::vector<SceneFault> list_;
};

/// An interval a number must lie in.
struct Range {
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
  bool low_open = false;
  bool high_open = false;
  const char* mend = "";  ///< what to do about a number outside; empty: the interval is told

  [[nodiscard]] bool holds(double x) const {
    return (low_open ? x > low : x >= low) && (high_open ? x < high : x <= high);
  }
  [[nodiscard]] std::string text() const;
};

inline constexpr Range kAnyNumber{};

/// Returns the candidate closest to `word` as ", did you mean "x"?", or "" where none is close.
[[nodiscard]] std::string did_you_mean(std::string_view word, std::span<const std::string> known);

/// Returns the number at `node`; nullopt where it is none. An integer beyond 2^53 is rounded, as it
/// would be with a point behind it (`toml::node::value<double>` takes it for no number).
[[nodiscard]] std::optional<double> number_of(const toml::node& node);

/// A table whose keys are read once each. Every fault has the place of the value concerned, and a
/// reading that fails returns the fallback, so that one pass finds all faults.
class TableReader {
 public:
  /// `title` names the table in faults: `[[tissue]] "proximal"`.
  TableReader(const toml::table& table, std::string title, Faults& faults)
      : table_(table), title_(std::move(title)), faults_(faults) {}

  [[nodiscard]] const toml::source_region& place() const { return table_.source(); }
  /// The place of a key's value, or of the table where the key is missing.
  [[nodiscard]] const toml::source_region& place(std::string_view key) const;
  [[nodiscard]] bool has(std::string_view key) const { return table_.contains(key); }
  void fault(std::string_view key, std::string what, std::string mend) {
    faults_.add(place(key), std::move(what), std::move(mend));
  }
  [[nodiscard]] Faults& faults() { return faults_; }
  [[nodiscard]] const std::string& title() const { return title_; }
  void rename(std::string title) { title_ = std::move(title); }

  double number(std::string_view key, double fallback, const Range& range);
  double required_number(std::string_view key, const Range& range, double fallback = 1.0);
  int integer(std::string_view key, int fallback, int low, int high);
  bool boolean(std::string_view key, bool fallback);
  /// An empty text is a fault: it names nothing.
  std::string text(std::string_view key, std::string fallback);
  std::string required_text(std::string_view key);
  /// One of `words`; returns its index.
  std::size_t choice(std::string_view key, std::size_t fallback,
                     std::span<const std::string> words);
  /// Each component within `range`; nullopt: missing or faulty.
  std::optional<Vec3> vector(std::string_view key, const Range& range = kAnyNumber);
  Vec3 required_vector(std::string_view key, const Range& range = kAnyNumber);
  Pose pose(std::string_view key);
  /// A table's own table; nullptr: missing or faulty.
  const toml::table* table(std::string_view key);
  /// An array; nullptr: missing or faulty.
  const toml::array* array(std::string_view key);
  std::vector<std::string> texts(std::string_view key);

  /// Reports the keys that nobody asked for.
  void finish();

 private:
  // The value of a key, marked as known.
  const toml::node* find(std::string_view key);
  void wrong_type(std::string_view key, const char* wanted);
  void missing(std::string_view key);
  std::optional<double> read_number(std::string_view key, const Range& range);
  std::optional<std::vector<double>> numbers(std::string_view key, std::size_t count,
                                             const char* wanted);

  const toml::table& table_;
  std::string title_;
  Faults& faults_;
  std::vector<std::string> known_;
};

}  // namespace sutured::scene
