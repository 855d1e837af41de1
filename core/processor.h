/* Functions that are compiled for more than one kind of processor, and what they are made of.
 *
 * A function marked FOR_EACH_PROCESSOR has a version with AVX2 and one without; which is called is chosen while the
 * program is loaded.  What it calls has to be INLINE to be compiled along with it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PROCESSOR_H
#define WHITTLE_CORE_PROCESSOR_H

/* Sanitizers can't stand functions that are chosen while the program is loaded. */
#if defined(__x86_64__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("avx2", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

#define INLINE static inline __attribute__((always_inline))

#endif
