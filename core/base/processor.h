/* Functions that are compiled for more than one kind of processor.
 *
 * The files that the Makefile names as kernels are compiled twice where it pays (KERNEL_CHOICE): for any processor, and
 * for those with AVX2 (KERNEL_AVX2).  What such a file shows to others it defines by
 *
 *     FOR_EACH_PROCESSOR(type, name)(parameters) { ... }
 *
 * which makes name_base or name_avx2 of it; which of them `name` is, is chosen while the program is loaded.  Everywhere
 * else that is name itself: make config=narrow (never AVX2), config=scalar (no vectors), the sanitizers, which can't
 * stand functions that are chosen while the program is loaded, and other processors.
 *
 * KERNEL_TWIN compiles the scalar form under the name name_scalar, for the unit tests to compare with.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_PROCESSOR_H
#define WHITTLE_CORE_BASE_PROCESSOR_H

#define INLINE static inline __attribute__((always_inline))

#if defined(KERNEL_TWIN)
#define FOR_EACH_PROCESSOR(type, name)                                                                                 \
    extern __typeof__(name) name##_scalar;                                                                             \
    type name##_scalar
#elif defined(KERNEL_AVX2)
#define FOR_EACH_PROCESSOR(type, name)                                                                                 \
    extern __typeof__(name) name##_avx2;                                                                               \
    type name##_avx2
#elif defined(KERNEL_CHOICE)
#define FOR_EACH_PROCESSOR(type, name)                                                                                 \
    extern __typeof__(name) name##_avx2, name##_base;                                                                  \
    __attribute__((used)) static __typeof__(name) *name##_chosen(void) {                                               \
        __builtin_cpu_init();                                                                                          \
        return __builtin_cpu_supports("avx2") ? name##_avx2 : name##_base;                                             \
    }                                                                                                                  \
    extern __typeof__(name) name __attribute__((ifunc(#name "_chosen")));                                              \
    type name##_base
#else
#define FOR_EACH_PROCESSOR(type, name) type name
#endif

#endif
