// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/blas_kernels.hpp"

#include <unistd.h>

#include <cstdlib>

extern "C" char* openblas_get_corename(void);

namespace sutured::fem {

std::string_view blas_kernels() noexcept { return openblas_get_corename(); }

void use_best_blas_kernels(char** argv) noexcept {
#if defined(__x86_64__)
  constexpr const char* kVariable = "OPENBLAS_CORETYPE";
  // What OpenBLAS falls back to for an x86-64 processor that its tables do not have.
  if (blas_kernels() != "Prescott" || std::getenv(kVariable) != nullptr) return;
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
  if (!avx2) return;
  if (setenv(kVariable, avx512 ? "SkylakeX" : "Haswell", 0) != 0) return;
  execv("/proc/self/exe", argv);
  unsetenv(kVariable);  // still here: no children shall differ from their parent
#else
  static_cast<void>(argv);
#endif
}

}  // namespace sutured::fem
