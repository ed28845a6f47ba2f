// SPDX-License-Identifier: Apache-2.0
#include "protocol/dds_log.hpp"

#include <dds/ddsrt/log.h>

#include <string_view>
#include <utility>

namespace suture {
namespace {

/// A line of Cyclone's with what it means where only OpenSSL knows.
std::string in_plain_words(std::string line) {
  // Of a certificate whose authority is none that this process was given.
  if (line.find("unable to get local issuer certificate") != std::string::npos)
    line += " (certificate of another authority)";
  return line;
}

}  // namespace

DdsLog::DdsLog(std::function<void(bool, const std::string&)> tell) : tell_(std::move(tell)) {
  const auto hear_one = [](void* self, const dds_log_data_t* data) {
    std::string_view text(data->message, data->size);
    while (text.ends_with('\n')) text.remove_suffix(1);
    static_cast<DdsLog*>(self)->hear((data->priority & (DDS_LC_ERROR | DDS_LC_FATAL)) != 0,
                                     std::string(text), Clock::now());
  };
  dds_set_log_sink(hear_one, this);
}

DdsLog::~DdsLog() { dds_set_log_sink(nullptr, nullptr); }

void DdsLog::hear(bool error, const std::string& line, Clock::time_point now) noexcept try {
  const std::unique_lock lock(mutex_, std::try_to_lock);
  if (!lock || (told_ >= kLines && now < begun_ + kPeriod)) {
    ++untold_;
    return;
  }
  if (told_ == 0 || now >= begun_ + kPeriod) {
    begun_ = now;
    told_ = 0;
    if (const std::uint64_t untold = untold_.exchange(0); untold > 0)
      tell_(false, std::to_string(untold) + " more lines of DDS were left out");
  }
  ++told_;
  tell_(error, in_plain_words(line));
} catch (...) {  // a line less: no reason to end what Cyclone does
  ++untold_;
}

}  // namespace suture
