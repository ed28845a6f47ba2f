// SPDX-License-Identifier: GPL-3.0-or-later
// The few BLAS and LAPACK routines used on dense systems, column-major. OpenBLAS picks its
// kernels for the processor at run time, and allocates nothing per call.
#pragma once

#include <cstdint>

extern "C" {
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dtrsm_(const char* side, const char* uplo, const char* trans, const char* diag, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b,
            const int* ldb);
void dtrsv_(const char* uplo, const char* trans, const char* diag, const int* n, const double* a,
            const int* lda, double* x, const int* incx);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
void dgemv_(const char* trans, const int* m, const int* n, const double* alpha, const double* a,
            const int* lda, const double* x, const int* incx, const double* beta, double* y,
            const int* incy);
}

namespace sutured::blas {

/// Factors the lower triangle of the n × n matrix `a` in place; returns false if not positive.
inline bool cholesky(int n, double* a, int lda) {
  if (n == 0) return true;
  int info = 0;
  dpotrf_("L", &n, a, &lda, &info);
  return info == 0;
}

/// b ← L⁻¹ b for `columns` right-hand sides.
inline void forward(int n, const double* l, int lda, double* b, int columns, int ldb) {
  if (n == 0 || columns == 0) return;
  const double one = 1.0;
  dtrsm_("L", "L", "N", "N", &n, &columns, &one, l, &lda, b, &ldb);
}

/// x ← L⁻ᵀ x.
inline void backward(int n, const double* l, int lda, double* x) {
  if (n == 0) return;
  const int one = 1;
  dtrsv_("L", "T", "N", &n, l, &lda, x, &one);
}

/// c ← c − aᵀ a, lower triangle; a is k × n.
inline void subtract_gram(int n, int k, const double* a, int lda, double* c, int ldc) {
  if (n == 0 || k == 0) return;
  const double minus = -1.0, plus = 1.0;
  dsyrk_("L", "T", &n, &k, &minus, a, &lda, &plus, c, &ldc);
}

/// y ← y + alpha op(a) x, a is m × n; `transposed` picks op.
inline void multiply_add(bool transposed, int m, int n, double alpha, const double* a, int lda,
                         const double* x, double* y) {
  if (m == 0 || n == 0) return;
  const double one = 1.0;
  const int step = 1;
  dgemv_(transposed ? "T" : "N", &m, &n, &alpha, a, &lda, x, &step, &one, y, &step);
}

}  // namespace sutured::blas
