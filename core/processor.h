/* Functions that are compiled for more than one kind of processor, and what they are made of.
 *
 * A function marked FOR_EACH_PROCESSOR has a version with AVX2 and one without; which is called is chosen while the
 * program is loaded.  What it calls has to be INLINE to be compiled along with it.
 *
 * Vectors of 32 bytes work everywhere, but without registers of that size GCC keeps them in memory and compares them
 * number by number.  Loops that do little but compare have a form for vectors of 16 bytes, too, for processors that
 * aren't wide.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PROCESSOR_H
#define WHITTLE_CORE_PROCESSOR_H

#include <stdbool.h>

#define INLINE static inline __attribute__((always_inline))

/* Sanitizers can't stand functions that are chosen while the program is loaded. */
#if defined(__x86_64__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("avx2", "default")))
INLINE bool processor_is_wide(void) { return __builtin_cpu_supports("avx2"); }
#else
#define FOR_EACH_PROCESSOR
INLINE bool processor_is_wide(void) { return false; }
#endif

#endif
