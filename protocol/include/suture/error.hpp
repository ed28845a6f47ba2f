// SPDX-License-Identifier: Apache-2.0
// The errors that cross a public border: what went wrong, and the mend.
#pragma once

#include <stdexcept>
#include <string>

namespace suture {

/// Names a cause that a program may want to act upon.
enum class ErrorCode {
  kNoServer,          ///< nobody answers in this domain and session
  kVersionMismatch,   ///< a server answers, and speaks another protocol version
  kUnknownTool,       ///< the server's scene has no tool of that name
  kToolInUse,         ///< another device holds the tool's lease
  kPermissionDenied,  ///< the operating system or DDS Security refuses
  kServerRunning,     ///< a server of this session runs in this domain already
  kNetwork,           ///< no usable interface, no free port, a bad configuration
  kIncompatibleQos,   ///< a peer asks for a quality of service that we do not offer
  kBadInput,          ///< an argument or a file
};

/// Reports a failure at set-up. `what()` is "cause; mend" in one line.
/// Hot calls (reading, writing, evaluating) never throw it.
class __attribute__((visibility("default"))) Error : public std::runtime_error {
 public:
  Error(ErrorCode code, std::string cause, std::string mend)
      : std::runtime_error(mend.empty() ? cause : cause + "; " + mend),
        code_(code),
        cause_(std::move(cause)),
        mend_(std::move(mend)) {}

  [[nodiscard]] ErrorCode code() const noexcept { return code_; }
  [[nodiscard]] const std::string& cause() const noexcept { return cause_; }
  /// What to do about it; may be empty.
  [[nodiscard]] const std::string& mend() const noexcept { return mend_; }

 private:
  ErrorCode code_;
  std::string cause_;
  std::string mend_;
};

}  // namespace suture
