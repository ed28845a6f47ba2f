// SPDX-License-Identifier: GPL-3.0-or-later
// One build serves every x86-64 processor: a function marked SUTURED_KERNEL is compiled for three
// generations and the loader picks (docs/adr/0003-simd.md). Sanitizers run before the loader
// has resolved such functions, and clang 14 has no target_clones: they get the plain one.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#define SUTURED_KERNEL \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"), noinline))
#else
#define SUTURED_KERNEL
#endif
