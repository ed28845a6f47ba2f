// SPDX-License-Identifier: Apache-2.0
// A browser without a display, for one page.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>

namespace suture::cli {

/// Finds a Chromium among what is installed: `asked`, or the first of the usual names in PATH.
/// Throws suture::Error: kBadInput where `asked` is no program, kNetwork where there is none.
[[nodiscard]] std::string find_chromium(const std::string& asked);

/// Thrown where a signal asked for the end (`interrupted`).
struct Interrupted {};
/// Thrown where the deadline passed.
struct TimedOut {};

/// A headless Chromium with a folder of its own, led by DevTools messages over a socket that
/// nobody else can reach (docs/adr/0045).
///
/// It and all its processes end, and its folder goes, with this object; if this process is
/// killed, it ends because its socket does. Thread: one.
class Chromium {
 public:
  using Clock = std::chrono::steady_clock;

  /// Starts `program`. Throws suture::Error kNetwork where it cannot start, and what `call` throws.
  Chromium(const std::string& program, Clock::time_point deadline);
  ~Chromium();
  Chromium(const Chromium&) = delete;
  Chromium& operator=(const Chromium&) = delete;

  /// Opens an empty page, which `call` then speaks of.
  void open_page();
  [[nodiscard]] bool has_page() const noexcept { return !page_.empty(); }
  /// Asks for `method` and returns its result.
  /// Throws suture::Error kNetwork where the browser refuses, or has ended; Interrupted; TimedOut.
  nlohmann::json call(const std::string& method, const nlohmann::json& parameters);
  /// Waits for the event `method` of the page. One that came since the last `call` began counts.
  /// Throws as `call` does.
  void await_event(const std::string& method);
  /// Gives what follows more time.
  void set_deadline(Clock::time_point deadline) { deadline_ = deadline; }

 private:
  void start(const std::string& program);
  void send(const std::string& message);
  /// Returns the next message of the browser.
  nlohmann::json receive();
  void wait_for(short readiness);
  [[noreturn]] void throw_ended();
  void end() noexcept;

  Clock::time_point deadline_;
  std::filesystem::path folder_;
  pid_t pid_ = -1;
  int socket_ = -1;
  std::string received_;
  std::size_t searched_ = 0;  ///< bytes of `received_` that hold no end of a message
  std::string page_;          ///< DevTools' name of the session with the page
  std::string events_;        ///< names of those that came since the last call, each with a newline
  std::int64_t calls_ = 0;
};

}  // namespace suture::cli
