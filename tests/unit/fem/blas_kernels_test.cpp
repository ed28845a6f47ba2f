// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/blas_kernels.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "support/process.hpp"

namespace sutured::fem {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

#if defined(__x86_64__)

// With OPENBLAS_VERBOSE=2, OpenBLAS prints its choice each time that it is loaded.
std::string output_of(const std::string& variables) {
  testing::Process program(
      {"/bin/sh", "-c", variables + " OPENBLAS_VERBOSE=2 \"$0\" --version", SUTURED_PROGRAM});
  EXPECT_EQ(program.wait(), 0) << program.output();
  return program.output();
}

TEST(BlasKernels, AProcessorUnknownToOpenBlasIsNotServedByItsOldestOnes) {
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
    GTEST_SKIP() << "this processor has nothing newer";
  const std::string output = output_of("env -u OPENBLAS_CORETYPE");
  const auto last = output.rfind("Core: ");
  ASSERT_NE(last, std::string::npos) << output;
  EXPECT_THAT(output.substr(last), Not(HasSubstr("Prescott"))) << output;
}

TEST(BlasKernels, TheUsersChoiceStands) {
  const std::string output = output_of("OPENBLAS_CORETYPE=Prescott");
  EXPECT_THAT(output, AllOf(HasSubstr("Core: Prescott"), Not(HasSubstr("Core: Haswell")),
                            Not(HasSubstr("Core: SkylakeX"))));
}

#endif

}  // namespace
}  // namespace sutured::fem
