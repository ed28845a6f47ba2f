// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <string>

#include "suture/error.hpp"

namespace sutured::testing {

/// Returns what the suture::Error of `work` says, cause and mend; empty where there is none. An
/// error without a mend fails the test.
inline std::string fault_of(const std::function<void()>& work) {
  try {
    work();
    return "";
  } catch (const suture::Error& error) {
    EXPECT_FALSE(error.mend().empty()) << error.cause();
    return error.what();
  }
}

}  // namespace sutured::testing
