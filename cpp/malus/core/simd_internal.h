#pragma once

/// Before a function without templates: the compiler makes a version for each of these instruction sets, and the loader
/// picks the best that the processor has. Only for inner loops that gain by it (measured); sums differ in rounding from
/// processor to processor, as fused multiplications do.
/// Not under sanitizers: the loader would pick before their own start, in instrumented code.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define MALUS_SIMD_CLONES [[gnu::target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")]]
#else
#define MALUS_SIMD_CLONES
#endif
