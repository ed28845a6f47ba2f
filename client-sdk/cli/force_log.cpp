// SPDX-License-Identifier: Apache-2.0
#include "force_log.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <system_error>
#include <utility>

namespace suture::cli {
namespace {

std::string reason() { return std::error_code(errno, std::generic_category()).message(); }

}  // namespace

double length_of(const Vector3& v) noexcept { return std::hypot(v[0], v[1], v[2]); }

void ForceTrace::add(double time_s, double force_n) {
  if (in_last_ == 0) {
    if (count_ == columns_.size()) merge_neighbours();
    columns_[count_++] = {time_s, force_n, force_n};
  } else {
    Column& last = columns_[count_ - 1];
    last.min_n = std::min(last.min_n, force_n);
    last.max_n = std::max(last.max_n, force_n);
  }
  in_last_ = (in_last_ + 1) % per_column_;
}

void ForceTrace::merge_neighbours() {
  for (std::size_t i = 0; i < count_ / 2; ++i) {
    const Column& a = columns_[2 * i];
    const Column& b = columns_[2 * i + 1];
    columns_[i] = {a.time_s, std::min(a.min_n, b.min_n), std::max(a.max_n, b.max_n)};
  }
  count_ /= 2;
  per_column_ *= 2;
}

ForceLog::ForceLog(const std::string& path, std::span<const std::string> tools) : path_(path) {
  for (const std::string& tool : tools) {
    lanes_.push_back(std::make_unique<Lane>());
    lanes_.back()->tool = tool;
  }
  if (!path.empty()) {
    int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    made_ = fd >= 0;
    if (fd < 0 && errno == EEXIST) fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0666);
    file_ = fd < 0 ? nullptr : ::fdopen(fd, "w");
    if (file_ == nullptr) {
      throw Error(ErrorCode::kBadInput, path + ": cannot be written: " + reason(),
                  "check the path and its permissions");
    }
  }
  worker_ = std::thread([this] { work(); });
}

ForceLog::~ForceLog() {
  finishing_ = true;
  if (worker_.joinable()) worker_.join();
  if (file_ != nullptr) std::fclose(file_);
  if (made_) ::unlink(path_.c_str());
}

void ForceLog::begin() {
  if (file_ == nullptr) return;
  struct stat facts {};
  const int fd = ::fileno(file_);
  if (::fstat(fd, &facts) == 0 && S_ISREG(facts.st_mode) && ::ftruncate(fd, 0) != 0) {
    throw Error(ErrorCode::kBadInput, path_ + ": cannot be written: " + reason(),
                "check the path and its permissions");
  }
  std::fputs(
      "time_s,tool,hand_sequence,force_sequence,state,faults,px_m,py_m,pz_m,qx,qy,qz,qw,jaw,"
      "fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm,round_trip_us,model_age_us\n",
      file_);
  made_ = false;
}

void ForceLog::push(std::size_t tool, const ForceRecord& record) noexcept {
  Lane& lane = *lanes_[tool];
  const std::uint64_t head = lane.head.load(std::memory_order_relaxed);
  if (head - lane.tail.load(std::memory_order_acquire) >= kCapacity) {
    lane.dropped.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  lane.ring[head % kCapacity] = record;
  lane.head.store(head + 1, std::memory_order_release);
}

std::uint64_t ForceLog::dropped() const noexcept {
  std::uint64_t sum = 0;
  for (const auto& lane : lanes_) sum += lane->dropped;
  return sum;
}

void ForceLog::finish() {
  finishing_ = true;
  if (worker_.joinable()) worker_.join();
  if (file_ == nullptr) return;
  const bool failed = std::ferror(file_) != 0;
  const bool closed = std::fclose(std::exchange(file_, nullptr)) == 0;
  if (failed || !closed) {
    throw Error(ErrorCode::kBadInput, path_ + ": is incomplete: " + reason(),
                "see whether the disk is full");
  }
}

void ForceLog::work() {
  while (!finishing_) {
    drain();
    // A pace, not a condition: forces are never waited for one by one.
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  drain();
}

void ForceLog::drain() {
  for (const auto& lane : lanes_) drain(*lane);
}

void ForceLog::drain(Lane& lane) {
  std::uint64_t tail = lane.tail.load(std::memory_order_relaxed);
  while (tail != lane.head.load(std::memory_order_acquire)) {
    const ForceRecord& record = lane.ring[tail % kCapacity];
    lane.trace.add(record.time_s, length_of(record.force.force_n));
    if (file_ != nullptr) write(lane, record);
    lane.tail.store(++tail, std::memory_order_release);
  }
}

void ForceLog::write(const Lane& lane, const ForceRecord& record) {
  const Hand& hand = record.hand;
  const Force& force = record.force;
  std::fprintf(
      file_,
      "%.6f,%s,%llu,%llu,%s,%u,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.6g,"
      "%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.1f,%u\n",
      record.time_s, lane.tool.c_str(), static_cast<unsigned long long>(force.hand_sequence),
      static_cast<unsigned long long>(force.sequence), name_of(force.state), force.faults,
      hand.position_m[0], hand.position_m[1], hand.position_m[2], hand.orientation_xyzw[0],
      hand.orientation_xyzw[1], hand.orientation_xyzw[2], hand.orientation_xyzw[3], hand.jaw,
      force.force_n[0], force.force_n[1], force.force_n[2], force.torque_nm[0], force.torque_nm[1],
      force.torque_nm[2], 1e-3 * static_cast<double>(force.round_trip_ns), force.model_age_us);
}

}  // namespace suture::cli
