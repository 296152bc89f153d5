/*
 * The double loop as a compiler vectorises it, with glibc's vector sines (libmvec): what a user gets from plain C with
 * `gcc -O3 -march=native -ffast-math`. One thread; directions outside, packets inside in blocks that stay in the first
 * cache. Sine and cosine have a loop each: in one loop gcc makes a call of sincos of them, which has no vector form.
 */
#include <math.h>

#define BLOCK 512

#define PROFILE(name, real, sine, cosine)                                                                              \
	void name(const real *restrict x, const real *restrict y, const real *restrict z, const real *restrict re,     \
		  const real *restrict im, long packets, const real *restrict u, long directions, real *restrict out)  \
	{                                                                                                              \
		real phase[BLOCK], s[BLOCK], c[BLOCK];                                                                 \
		for (long d = 0; d < directions; d++) {                                                                \
			real ux = u[d], uy = u[directions + d], uz = u[2 * directions + d], a = 0, b = 0;              \
			for (long from = 0; from < packets; from += BLOCK) {                                           \
				long n = packets - from < BLOCK ? packets - from : BLOCK;                              \
				for (long t = 0; t < n; t++)                                                           \
					phase[t] = ux * x[from + t] + uy * y[from + t] + uz * z[from + t];             \
				for (long t = 0; t < n; t++)                                                           \
					s[t] = sine(phase[t]);                                                         \
				for (long t = 0; t < n; t++)                                                           \
					c[t] = cosine(phase[t]);                                                       \
				for (long t = 0; t < n; t++) {                                                         \
					a += re[from + t] * c[t] + im[from + t] * s[t];                                \
					b += im[from + t] * c[t] - re[from + t] * s[t];                                \
				}                                                                                      \
			}                                                                                              \
			out[d] = a * a + b * b;                                                                        \
		}                                                                                                      \
	}

PROFILE(profile_f64, double, sin, cos)
PROFILE(profile_f32, float, sinf, cosf)
