// SPDX-License-Identifier: GPL-3.0-or-later
// Which of OpenBLAS's kernels a program computes with (docs/adr/0049-blas-kernels.md).
#pragma once

#include <string_view>

namespace sutured::fem {

/// Returns the kernels OpenBLAS chose as the program was loaded: "Haswell", "SkylakeX", …
[[nodiscard]] std::string_view blas_kernels() noexcept;

/// Starts the program anew, in the same process, with OPENBLAS_CORETYPE set, where OpenBLAS took
/// its oldest kernels because it does not know a processor that could do more: it reads the
/// variable when it is loaded, and only then. Returns where nothing is to be done, where the user
/// set the variable, or where the program cannot be started anew; then it computes slower.
///
/// Call it first in `main`, with its `argv`: what the program did before is done again.
void use_best_blas_kernels(char** argv) noexcept;

}  // namespace sutured::fem
