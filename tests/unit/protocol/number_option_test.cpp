// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/number_option.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace suture {
namespace {

using ::testing::HasSubstr;

TEST(NumberOption, TakesWhatLiesWithinItsBounds) {
  const auto check = within(0.5, 4000.0, "Hz");
  for (const char* text : {"0.5", "4000", "1e3", "250.25"}) EXPECT_EQ(check(text), "") << text;
}

TEST(NumberOption, SaysWhatItTakesWhereItRefuses) {
  const auto check = within(0.5, 4000.0, "Hz");
  for (const char* text : {"nan", "inf", "-inf", "-1", "0", "0.49", "4001", "", "12x", "fast"})
    EXPECT_THAT(check(text), HasSubstr(std::string("\"") + text +
                                       "\" will not do: take a number from 0.5 to "
                                       "4000 Hz"));
}

}  // namespace
}  // namespace suture
