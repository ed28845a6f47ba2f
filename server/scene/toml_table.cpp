// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/toml_table.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <tuple>

#include "scene/physical_ranges.hpp"

namespace sutured::scene {

namespace {

std::string number_text(double x) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%g", x);
  return text.data();
}

// The number of single-character edits, swaps of neighbours included, from one word to the other.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> before(b.size() + 1), above(b.size() + 1), row(b.size() + 1);
  std::iota(above.begin(), above.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t change = above[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      row[j] = std::min({above[j] + 1, row[j - 1] + 1, change});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        row[j] = std::min(row[j], before[j - 2] + 1);
    }
    std::swap(before, above);
    std::swap(above, row);
  }
  return above[b.size()];
}

}  // namespace

std::vector<SceneFault> Faults::sorted() const {
  std::vector<SceneFault> sorted = list_;
  std::stable_sort(sorted.begin(), sorted.end(), [&](const SceneFault& a, const SceneFault& b) {
    return std::tuple(a.file != file_, a.line, a.column) <
           std::tuple(b.file != file_, b.line, b.column);
  });
  return sorted;
}

std::string Range::text() const {
  const bool has_low = std::isfinite(low);
  const bool has_high = std::isfinite(high);
  std::string text;
  if (has_low) text += (low_open ? "above " : "at least ") + number_text(low);
  if (has_low && has_high) text += " and ";
  if (has_high) text += (high_open ? "below " : "at most ") + number_text(high);
  return text;
}

std::string did_you_mean(std::string_view word, std::span<const std::string> known) {
  std::size_t best = std::max<std::size_t>(1, word.size() / 3) + 1;
  const std::string* meant = nullptr;
  for (const std::string& candidate : known) {
    // A word with its unit left off, or with another one, is as close as a slip of the finger.
    const bool extends = word.size() >= 3 && candidate.starts_with(std::string(word) + '_');
    const std::size_t distance = extends ? 1 : edit_distance(word, candidate);
    if (distance >= best) continue;
    best = distance;
    meant = &candidate;
  }
  return meant == nullptr ? "" : ", did you mean \"" + *meant + "\"?";
}

std::optional<double> number_of(const toml::node& node) {
  if (const auto* integer = node.as_integer()) return static_cast<double>(integer->get());
  return node.value_exact<double>();
}

const toml::source_region& TableReader::place(std::string_view key) const {
  const toml::node* node = table_.get(key);
  return node == nullptr ? table_.source() : node->source();
}

const toml::node* TableReader::find(std::string_view key) {
  known_.emplace_back(key);
  return table_.get(key);
}

void TableReader::wrong_type(std::string_view key, const char* wanted) {
  fault(key, std::string(key) + " of " + title_ + " is not " + wanted,
        std::string("write ") + wanted);
}

void TableReader::missing(std::string_view key) {
  faults_.add(table_.source(), title_ + " has no " + std::string(key),
              "add " + std::string(key) + " = …");
}

std::optional<double> TableReader::read_number(std::string_view key, const Range& range) {
  const toml::node* node = find(key);
  if (node == nullptr) return std::nullopt;
  const std::optional<double> given = number_of(*node);
  if (!given) {
    wrong_type(key, "a number");
    return std::nullopt;
  }
  const double x = *given;
  if (std::isfinite(x) && range.holds(x)) return x;
  const std::string wanted = std::isfinite(x) ? range.text() : "a finite number";
  fault(key,
        std::string(key) + " of " + title_ + " is " + number_text(x) + " and must be " + wanted,
        *range.mend != '\0' ? range.mend : "write a number that is " + wanted);
  return std::nullopt;
}

double TableReader::number(std::string_view key, double fallback, const Range& range) {
  return read_number(key, range).value_or(fallback);
}

double TableReader::required_number(std::string_view key, const Range& range, double fallback) {
  if (!has(key)) missing(key);
  return number(key, fallback, range);
}

int TableReader::integer(std::string_view key, int fallback, int low, int high) {
  const toml::node* node = find(key);
  if (node == nullptr) return fallback;
  const auto value = node->value_exact<std::int64_t>();
  if (value && *value >= low && *value <= high) return static_cast<int>(*value);
  const std::string wanted =
      "an integer from " + std::to_string(low) + " to " + std::to_string(high);
  wrong_type(key, wanted.c_str());
  return fallback;
}

bool TableReader::boolean(std::string_view key, bool fallback) {
  const toml::node* node = find(key);
  if (node == nullptr) return fallback;
  if (!node->is_boolean()) wrong_type(key, "true or false");
  return node->value_exact<bool>().value_or(fallback);
}

std::string TableReader::text(std::string_view key, std::string fallback) {
  const toml::node* node = find(key);
  if (node == nullptr) return fallback;
  if (!node->is_string()) {
    wrong_type(key, "a text in quotes");
    return fallback;
  }
  std::string text = *node->value_exact<std::string>();
  if (!text.empty()) return text;
  fault(key, std::string(key) + " of " + title_ + " is an empty text", "write what it names");
  return fallback;
}

std::string TableReader::required_text(std::string_view key) {
  if (!has(key)) missing(key);
  return text(key, "");
}

std::size_t TableReader::choice(std::string_view key, std::size_t fallback,
                                std::span<const std::string> words) {
  if (!has(key)) {
    known_.emplace_back(key);
    return fallback;
  }
  const std::string word = text(key, words[fallback]);
  const auto found = std::find(words.begin(), words.end(), word);
  if (found != words.end()) return static_cast<std::size_t>(found - words.begin());
  std::string mend = "write ";
  for (std::size_t i = 0; i < words.size(); ++i)
    mend += (i == 0 ? "\"" : " or \"") + words[i] + '"';
  fault(key, std::string(key) + " of " + title_ + " is \"" + word + "\", which is not known", mend);
  return fallback;
}

std::optional<std::vector<double>> TableReader::numbers(std::string_view key, std::size_t count,
                                                        const char* wanted) {
  const toml::node* node = find(key);
  if (node == nullptr) return std::nullopt;
  const toml::array* array = node->as_array();
  std::vector<double> values;
  if (array != nullptr)
    for (const toml::node& item : *array)
      if (const auto x = number_of(item)) values.push_back(*x);
  const bool finite =
      std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
  if (array == nullptr || array->size() != count || values.size() != count || !finite) {
    wrong_type(key, wanted);
    return std::nullopt;
  }
  return values;
}

std::optional<Vec3> TableReader::vector(std::string_view key, const Range& range) {
  const auto values = numbers(key, 3, "three finite numbers [x, y, z]");
  if (!values) return std::nullopt;
  for (const double x : *values) {
    if (range.holds(x)) continue;
    fault(key,
          std::string(key) + " of " + title_ + " holds " + number_text(x) + " and each must be " +
              range.text(),
          range.mend);
    return std::nullopt;
  }
  return Vec3((*values)[0], (*values)[1], (*values)[2]);
}

Vec3 TableReader::required_vector(std::string_view key, const Range& range) {
  if (!has(key)) missing(key);
  return vector(key, range).value_or(Vec3::Zero());
}

Pose TableReader::pose(std::string_view key) {
  Pose pose;
  const toml::table* inner = table(key);
  if (inner == nullptr) return pose;
  TableReader reader(*inner, std::string(key) + " of " + title_, faults_);
  pose.position_m = reader.vector("position_m", kPlace).value_or(Vec3::Zero());
  const auto q =
      reader.numbers("orientation", 4, "a quaternion of four finite numbers [x, y, z, w]");
  if (q) {
    const Eigen::Quaterniond quaternion((*q)[3], (*q)[0], (*q)[1], (*q)[2]);
    const double length = quaternion.norm();
    if (std::abs(length - 1.0) <= 1e-3) {
      pose.orientation = quaternion.normalized();
    } else {
      reader.fault("orientation",
                   "the quaternion of " + title_ + " has the length " + number_text(length) +
                       ", a rotation has 1",
                   "write [x, y, z, w] of length 1; [0, 0, 0, 1] is no rotation");
    }
  }
  reader.finish();
  return pose;
}

const toml::table* TableReader::table(std::string_view key) {
  const toml::node* node = find(key);
  if (node == nullptr) return nullptr;
  if (!node->is_table()) wrong_type(key, "a table { … }");
  return node->as_table();
}

const toml::array* TableReader::array(std::string_view key) {
  const toml::node* node = find(key);
  if (node == nullptr) return nullptr;
  if (!node->is_array()) wrong_type(key, "a list [ … ]");
  return node->as_array();
}

std::vector<std::string> TableReader::texts(std::string_view key) {
  std::vector<std::string> texts;
  const toml::array* items = array(key);
  if (items == nullptr) return texts;
  for (const toml::node& item : *items) {
    if (const auto text = item.value_exact<std::string>())
      texts.push_back(*text);
    else
      faults_.add(item.source(),
                  std::string(key) + " of " + title_ + " holds something else than names",
                  "write [\"name\", …]");
  }
  return texts;
}

void TableReader::finish() {
  for (const auto& [key, value] : table_) {
    if (std::find(known_.begin(), known_.end(), key.str()) != known_.end()) continue;
    faults_.add(key.source(),
                "unknown key \"" + std::string(key.str()) + "\" in " + title_ +
                    did_you_mean(key.str(), known_),
                "correct or delete it");
  }
}

}  // namespace sutured::scene
