// SPDX-License-Identifier: Apache-2.0
// Whether what a program printed has arrived: a full disk behind a redirection is else found by
// nobody, when the program has ended with 0.
#pragma once

#include <cerrno>
#include <cstdio>
#include <string>
#include <system_error>

namespace suture {

/// Writes what standard output still holds, std::cout's included. Returns the error to tell where
/// this or an earlier write failed, else an empty text. Call it once, behind the last print.
[[nodiscard]] inline std::string standard_output_fault() {
  errno = 0;
  const bool flushed = std::fflush(stdout) == 0;
  const int reason = errno;
  if (flushed && std::ferror(stdout) == 0) return {};
  return "the output could not be written" +
         (flushed || reason == 0 ? std::string() : ": " + std::generic_category().message(reason)) +
         "; see to where standard output goes";
}

}  // namespace suture
