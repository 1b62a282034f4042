#pragma once

/// Put this before a function that is not a template: the compiler makes a version for each of these instruction sets,
/// and the loader picks the best one that the processor supports. Only for inner loops that measurably gain by it. Sums
/// then differ in rounding from processor to processor, because of fused multiply-adds.
/// Not under sanitizers: the loader would pick a version, in instrumented code, before the sanitizer has started.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define MALUS_SIMD_CLONES [[gnu::target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")]]
#else
#define MALUS_SIMD_CLONES
#endif
