// SPDX-License-Identifier: Apache-2.0
#include "commands.hpp"

#include <unistd.h>

namespace suture::cli {

std::atomic<bool> interrupted{false};

bool on_terminal() noexcept { return isatty(STDOUT_FILENO) == 1; }

}  // namespace suture::cli
