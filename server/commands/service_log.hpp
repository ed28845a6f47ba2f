// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <string>

namespace spdlog {
class logger;
}

namespace sutured::commands {

/// Says whether standard error goes to systemd's journal, by the JOURNAL_STREAM of
/// systemd.exec(5).
[[nodiscard]] bool logs_to_journal();

/// Returns a logger on standard error: with time, level and colour for people; for the journal,
/// which has its own time, with the level as the prefix `<N>` of sd-daemon(3). A message of several
/// lines has it before each of them. Threads: any.
[[nodiscard]] std::shared_ptr<spdlog::logger> make_service_log();

/// Says whether a line to standard error would be taken at once: false where it is a pipe that
/// nobody empties. Threads: any.
[[nodiscard]] bool can_tell() noexcept;

/// Writes what ended a command to standard error; in the journal as an error.
void tell_failure(const std::string& text);

}  // namespace sutured::commands
