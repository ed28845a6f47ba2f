// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/service_log.hpp"

#include <poll.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string_view>
#include <utility>

namespace sutured::commands {
namespace {

/// The levels of syslog(3) that the journal knows.
std::string_view prefix_of(spdlog::level::level_enum level) {
  switch (level) {
    case spdlog::level::critical:
      return "<2>";
    case spdlog::level::err:
      return "<3>";
    case spdlog::level::warn:
      return "<4>";
    case spdlog::level::info:
      return "<6>";
    default:
      return "<7>";
  }
}

/// Begins each line of `text` with `prefix`, and ends the last one.
template <class Text>
void put_lines(std::string_view text, std::string_view prefix, Text& out) {
  do {
    const std::string_view line = text.substr(0, text.find('\n'));
    out.append(prefix.data(), prefix.data() + prefix.size());
    out.append(line.data(), line.data() + line.size());
    out.push_back('\n');
    text.remove_prefix(std::min(line.size() + 1, text.size()));
  } while (!text.empty());
}

class JournalFormatter final : public spdlog::formatter {
 public:
  void format(const spdlog::details::log_msg& message, spdlog::memory_buf_t& out) override {
    put_lines({message.payload.data(), message.payload.size()}, prefix_of(message.level), out);
  }
  [[nodiscard]] std::unique_ptr<formatter> clone() const override {
    return std::make_unique<JournalFormatter>();
  }
};

}  // namespace

bool logs_to_journal() {
  // concurrency: read at set-up; nothing in this program calls setenv.
  const char* stream = std::getenv("JOURNAL_STREAM");  // NOLINT(concurrency-mt-unsafe)
  struct stat file {};
  return stream != nullptr && fstat(STDERR_FILENO, &file) == 0 &&
         std::to_string(file.st_dev) + ':' + std::to_string(file.st_ino) == stream;
}

std::shared_ptr<spdlog::logger> make_service_log() {
  if (!logs_to_journal()) return spdlog::stderr_color_mt("sutured");
  auto log = spdlog::stderr_logger_mt("sutured");
  log->set_formatter(std::make_unique<JournalFormatter>());
  return log;
}

bool can_tell() noexcept {
  pollfd error{STDERR_FILENO, POLLOUT, 0};
  return poll(&error, 1, 0) > 0 && (error.revents & POLLOUT) != 0;
}

void tell_failure(const std::string& text) {
  if (!logs_to_journal()) {
    std::cerr << text << (text.ends_with('\n') ? "" : "\n");
    return;
  }
  std::string lines;
  put_lines(text, prefix_of(spdlog::level::err), lines);
  std::cerr << lines;
}

}  // namespace sutured::commands
