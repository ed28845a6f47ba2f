// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_folder.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <system_error>

#include "protocol/whole_file.hpp"

namespace sutured::checkpoints {
namespace {

constexpr std::string_view kSecond = "second.", kNamed = "named.", kEnding = ".checkpoint";
constexpr std::size_t kNameMax = 32;

std::optional<std::uint64_t> number_in(std::string_view text) {
  std::uint64_t number = 0;
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (fault != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

std::optional<std::uint64_t> sequence_of(const std::string& file) {
  if (!file.starts_with(kSecond) || !file.ends_with(kEnding)) return std::nullopt;
  if (file.size() < kSecond.size() + kEnding.size()) return std::nullopt;
  return number_in(
      std::string_view(file).substr(kSecond.size(), file.size() - kSecond.size() - kEnding.size()));
}

// Whether a write that a crash cut off left it here. Others' files are none of ours.
bool is_cut_off(const std::string& file) {
  return (file.starts_with(kSecond) || file.starts_with(kNamed)) &&
         file.ends_with(std::string(kEnding) + suture::WholeFile::kSuffix);
}

[[noreturn]] void fail(const std::filesystem::path& folder, const std::string& what,
                       const std::string& mend) {
  throw CheckpointError(folder.string() + ": " + what + "; " + mend);
}

}  // namespace

std::string fault_of_name(std::string_view name) {
  const auto allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' ||
           c == '_';
  };
  if (!name.empty() && name.size() <= kNameMax && std::all_of(name.begin(), name.end(), allowed))
    return "";
  return "a checkpoint's name has 1 to 32 letters, digits, '-' and '_'";
}

CheckpointFolder::CheckpointFolder(Options options, Identity identity)
    : options_(std::move(options)), identity_(std::move(identity)) {
  options_.keep = std::max<std::size_t>(options_.keep, 2);
  const std::filesystem::path& folder = options_.folder;
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  if (failed) fail(folder, "cannot be made: " + failed.message(), "choose another --checkpoints");
  lock_fd_ = ::open((folder / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (lock_fd_ < 0)
    fail(folder, "cannot be written: " + std::generic_category().message(errno),
         "choose another --checkpoints");
  if (::flock(lock_fd_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_fd_);
    fail(folder, "another server keeps its checkpoints here", "give each server a folder");
  }
  read_folder();
}

CheckpointFolder::~CheckpointFolder() { ::close(lock_fd_); }

std::filesystem::path CheckpointFolder::path_of(std::uint64_t sequence) const {
  std::array<char, 32> number{};
  std::snprintf(number.data(), number.size(), "%010llu", static_cast<unsigned long long>(sequence));
  return options_.folder / (std::string(kSecond) + number.data() + std::string(kEnding));
}

std::filesystem::path CheckpointFolder::path_of(const std::string& name) const {
  if (std::string fault = fault_of_name(name); !fault.empty())
    throw CheckpointError("\"" + name + "\": " + fault);
  return options_.folder / (std::string(kNamed) + name + std::string(kEnding));
}

void CheckpointFolder::read_folder() {
  std::error_code failed;
  std::filesystem::directory_iterator entries(options_.folder, failed);
  for (; !failed && entries != std::filesystem::directory_iterator(); entries.increment(failed)) {
    const std::filesystem::directory_entry& entry = *entries;
    const std::string name = entry.path().filename().string();
    if (is_cut_off(name)) {
      std::error_code ignored;
      std::filesystem::remove(entry.path(), ignored);
      continue;
    }
    const auto sequence = sequence_of(name);
    if (!sequence) continue;
    last_ = std::max(last_, *sequence);
    files_.insert(*sequence);
    // One whose head cannot be read stays a candidate: whoever asks for it is told.
    CheckpointInfo info;
    info.identity = identity_;
    info.time_s = std::numeric_limits<double>::quiet_NaN();
    info.previous = *sequence - 1;
    try {
      info = read_checkpoint_info(entry.path());
    } catch (const CheckpointError&) {
    }
    if (info.identity == identity_)
      known_[*sequence] = info;
    else
      others_[*sequence] = info.identity;
  }
  if (failed)
    fail(options_.folder, "cannot be read: " + failed.message(), "choose another --checkpoints");
  ended_ = std::filesystem::exists(options_.folder / "ended") || last_ == 0;
  std::string text;
  std::ifstream resumed(options_.folder / "resumed");
  if (std::getline(resumed, text)) resumed_before_ = number_in(text).value_or(0);
  std::error_code ignored;
  std::filesystem::remove(options_.folder / "ended", ignored);
}

std::uint64_t CheckpointFolder::write(CheckpointInfo info, std::span<const std::byte> state) {
  const std::lock_guard lock(mutex_);
  info.identity = identity_;
  info.sequence = last_ + 1;
  write_checkpoint(path_of(info.sequence), info, state);
  last_ = info.sequence;
  known_[last_] = info;
  if (resumed_before_ != 0) {
    resumed_before_ = 0;
    std::error_code ignored;
    std::filesystem::remove(options_.folder / "resumed", ignored);
  }
  // The oldest go, whosever they are: numbers go on from one server, scene and build to the next.
  files_.insert(last_);
  while (files_.size() > options_.keep) {
    std::error_code ignored;
    std::filesystem::remove(path_of(*files_.begin()), ignored);
    known_.erase(*files_.begin());
    others_.erase(*files_.begin());
    files_.erase(files_.begin());
  }
  return last_;
}

void CheckpointFolder::write(const std::string& name, CheckpointInfo info,
                             std::span<const std::byte> state) {
  const std::filesystem::path path = path_of(name);
  const std::lock_guard lock(mutex_);
  info.identity = identity_;
  write_checkpoint(path, info, state);
}

CheckpointFolder::Newest CheckpointFolder::newest() {
  const std::lock_guard lock(mutex_);
  Newest newest;
  std::vector<std::string> refused;  // in their order, others' among them
  for (auto file = files_.rbegin(); file != files_.rend(); ++file) {
    const std::filesystem::path path = path_of(*file);
    const auto other = others_.find(*file);
    try {
      if (other != others_.end()) expect_same(path, other->second, identity_);
      if (resumed_before_ != 0 && *file >= resumed_before_)
        throw CheckpointError(path.string() +
                              (*file > resumed_before_
                                   ? ": was refused by the server before"
                                   : ": a server that went on from it died before it had written "
                                     "another"));
      newest.checkpoint = read_checkpoint(path, identity_);
      return newest;
    } catch (const CheckpointError& error) {
      refused.emplace_back(error.what());
      if (other == others_.end()) newest.refused.emplace_back(error.what());
    }
  }
  newest.refused = std::move(refused);
  return newest;
}

CheckpointFolder::Found CheckpointFolder::in_the_past_of(std::uint64_t sequence, double time_s) {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> refused;
  double young_s = std::numeric_limits<double>::infinity();
  for (auto known = known_.find(sequence); known != known_.end();
       known = known_.find(known->second.previous)) {
    if (!std::isnan(known->second.time_s)) young_s = known->second.time_s;
    const auto before = known_.find(known->second.previous);
    // What has a later time is of the world before a reset.
    const bool last =
        before == known_.end() || before->first >= known->first || before->second.time_s > young_s;
    if (known->second.time_s <= time_s || last) {
      try {
        return Found{read_checkpoint(path_of(known->first), identity_), refused};
      } catch (const CheckpointError& error) {
        refused.emplace_back(error.what());
      }
    }
    if (last) break;
  }
  throw CheckpointError(refused.empty() ? "there is no checkpoint to go back to yet"
                                        : refused.front());
}

Checkpoint CheckpointFolder::named(const std::string& name) const {
  const std::filesystem::path path = path_of(name);
  const std::lock_guard lock(mutex_);
  std::error_code failed;
  if (!std::filesystem::exists(path, failed))
    throw CheckpointError("there is no checkpoint \"" + name + "\"" +
                          (failed ? ": " + failed.message() : ""));
  return read_checkpoint(path, identity_);
}

void CheckpointFolder::note_resumed(std::uint64_t sequence) {
  const std::lock_guard lock(mutex_);
  resumed_before_ = sequence;
  std::ofstream(options_.folder / "resumed") << sequence << '\n';
}

void CheckpointFolder::note_ended() {
  const std::lock_guard lock(mutex_);
  std::ofstream(options_.folder / "ended") << "as asked\n";
}

}  // namespace sutured::checkpoints
