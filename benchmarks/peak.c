/* As many fused multiply-adds as the cores can do: sums that do not wait for each other, nothing in memory. */
#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#else
#define BYTES 16
#endif
#define SUMS 12 /* more than latency times throughput of any core, few enough for 16 registers */

typedef double vector __attribute__((vector_size(BYTES)));

/* Runs `turns` on each core and returns how many operations they were, all cores together. */
double multiply_add(long turns, int cores, double *kept) {
#pragma omp parallel for num_threads(cores) schedule(static, 1)
  for (int core = 0; core < cores; core++) {
    vector sum[SUMS], factor = {0}, term = {0};
    factor += 0.999 + 1e-9 * core, term += 1e-3;
    for (int i = 0; i < SUMS; i++) sum[i] = term * (double)i;
    for (long turn = 0; turn < turns; turn++)
#pragma GCC unroll 12
      for (int i = 0; i < SUMS; i++) sum[i] = sum[i] * factor + term;
    for (int i = 1; i < SUMS; i++) sum[0] += sum[i];
    kept[core] = sum[0][0];
  }
  return 2.0 * turns * cores * SUMS * (BYTES / sizeof(double));
}
