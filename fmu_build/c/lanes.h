/* Vectors of W numbers, one of each of W vehicles, for AVX-512 or AVX2.  Each operation gives the bits of its scalar form: the second of two
   numbers is the minimum or the maximum where they cannot be told apart, and what compares with NaN is false. */

#include <immintrin.h>
#include <math.h>

/* A call would write all vectors to memory. */
#define V static inline __attribute__((always_inline))

/* Divisors up to this, and down to its inverse, have an inverse that serves; others have the tiny number, which makes of no number a
   quotient that is as large as the least that is sound. */
#define HS_NEAR 0x1p100
#define HS_TINY 0x1p-1074
#define HS_LEAST 0x1p-50

static inline double hs_inverse(double b) {
  const int special = b == 0 || !(fabs(b) <= 0x1.fffffffffffffp1023);
  return special || (fabs(b) >= 1 / HS_NEAR && fabs(b) <= HS_NEAR) ? 1 / b : copysign(HS_TINY, b);
}

#ifdef __AVX512DQ__

enum { W = 8 };
typedef __m512d vd;   /* numbers */
typedef __mmask8 vm;  /* flags */
typedef __m512i vi;   /* positions */

V vd v_set(double a) { return _mm512_set1_pd(a); }
V vd v_load(const double *a) { return _mm512_load_pd(a); }
V void v_store(double *a, vd x) { _mm512_store_pd(a, x); }
V vd v_min(vd a, vd b) { return _mm512_min_pd(a, b); }
V vd v_max(vd a, vd b) { return _mm512_max_pd(a, b); }
V vd v_sqrt(vd a) { return _mm512_sqrt_pd(a); }
V vd v_fabs(vd a) { return _mm512_abs_pd(a); }
V vd v_floor(vd a) { return _mm512_roundscale_pd(a, 9); }
V vd v_ceil(vd a) { return _mm512_roundscale_pd(a, 10); }
V vm v_lt(vd a, vd b) { return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ); }
V vm v_le(vd a, vd b) { return _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ); }
V vm v_eq(vd a, vd b) { return _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ); }
V vm v_ne(vd a, vd b) { return _mm512_cmp_pd_mask(a, b, _CMP_NEQ_UQ); }
V vm v_not(vm a) { return _knot_mask8(a); }
V vm v_and(vm a, vm b) { return _kand_mask8(a, b); }
V vm v_or(vm a, vm b) { return _kor_mask8(a, b); }
V vm v_all(int a) { return a ? 0xff : 0; }
V int v_bits(vm a) { return a; }
V vm v_of_bits(int a) { return (vm)a; }
V vd v_choose(vm m, vd a, vd b) { return _mm512_mask_blend_pd(m, b, a); }
V vd v_only(vm m, vd a) { return _mm512_maskz_mov_pd(m, a); }

V vi v_at(long i) { return _mm512_set1_epi64(i); }
V vi v_plus(vi a, vi b) { return _mm512_add_epi64(a, b); }
V vi v_times(vi a, int b) { return _mm512_mul_epu32(a, _mm512_set1_epi64(b)); }
V vi v_next(vm m, vi i, int step) { return _mm512_mask_add_epi64(i, m, i, _mm512_set1_epi64(step)); }
V vi v_trunc(vd a) { return _mm512_cvttpd_epi64(a); }
V vd v_number_of(vi i) { return _mm512_cvtepi64_pd(i); }
V vi v_lanes(void) { return _mm512_set_epi64(7, 6, 5, 4, 3, 2, 1, 0); }
V void v_keep(long long *a, vi i) { _mm512_store_si512((void *)a, i); }
V vd v_gather(const double *a, vi i) { return _mm512_i64gather_pd(i, a, 8); }
V vi v_gather_int(const int *a, vi i) { return _mm512_cvtepi32_epi64(_mm512_i64gather_epi32(i, a, 4)); }


/* Quotients by a divisor of which the inverse is known, to the last bit, in a third of a division's time.  A divisor that is neither
   special (zero, infinite, not a number) nor near to 1 within HS_NEAR has a tiny number in place of its inverse.

   After two corrections a quotient is the rounded one (Markstein, 1990), so long as no remainder underflows.  Where a or b is special the
   product is the quotient.  What is left, which is next to nothing, is divided. */
#define SPECIAL 0x9f
V vd v_inverse(vd b, vm *special) {
  const vd size = v_fabs(b);
  *special = _mm512_fpclass_pd_mask(b, SPECIAL);
  const vm far = v_or(v_lt(size, v_set(1 / HS_NEAR)), v_lt(v_set(HS_NEAR), size));
  const vd tiny = _mm512_or_pd(v_set(HS_TINY), _mm512_and_pd(b, v_set(-0.)));
  return v_choose(v_and(far, v_not(*special)), tiny, v_set(1) / b);
}
V vd v_quotient_of(vd a, vd b, vd inverse, vm special) {
  const vd product = a * inverse;
  vd q = _mm512_fmadd_pd(_mm512_fnmadd_pd(b, product, a), inverse, product);
  q = _mm512_fmadd_pd(_mm512_fnmadd_pd(b, q, a), inverse, q);
  const vm sound = v_le(v_set(HS_LEAST), v_fabs(q));
  if (__builtin_expect(!_kortestc_mask8_u8(special, sound), 0)) return a / b;
  return v_choose(special, product, q);
}
V vd v_quotient(vd a, vd b, vd inverse, vm special) {
  return v_quotient_of(a, b, inverse, v_or(special, _mm512_fpclass_pd_mask(a, SPECIAL)));
}
V vd v_ratio(vd a, vd b, vd inverse) { return v_quotient_of(a, b, inverse, _mm512_fpclass_pd_mask(a, SPECIAL)); }

/* An entry of a table of at most 8, 16 or 32. */
V vd v_pick8(const double *a, vi i) { return _mm512_permutexvar_pd(i, v_load(a)); }
V vd v_pick16(const double *a, vi i) { return _mm512_permutex2var_pd(v_load(a), i, v_load(a + 8)); }
V vd v_pick32(const double *a, vi i) {
  return v_choose(_mm512_test_epi64_mask(i, v_at(16)), v_pick16(a + 16, i), v_pick16(a, i));
}

/* How many of rising numbers, padded with NaN to 7, 15 or 31, `x` has reached. */
V vi v_find8(const double *a, vd x) {
  const vm high = v_le(v_set(a[3]), x);
  vi i = v_next(high, v_at(0), 4);
  i = v_next(v_le(v_choose(high, v_set(a[5]), v_set(a[1])), x), i, 2);
  return v_next(v_le(v_pick8(a, i), x), i, 1);
}
V vi v_find16(const double *a, vd x) {
  const vm high = v_le(v_set(a[7]), x);
  vi i = v_next(high, v_at(0), 8);
  i = v_next(v_le(v_choose(high, v_set(a[11]), v_set(a[3])), x), i, 4);
  i = v_next(v_le(v_pick16(a, v_plus(i, v_at(1))), x), i, 2);
  return v_next(v_le(v_pick16(a, i), x), i, 1);
}
V vi v_find32(const double *a, vd x) {
  const vm high = v_le(v_set(a[15]), x);
  vi i = v_next(high, v_at(0), 16);
  i = v_next(v_le(v_choose(high, v_set(a[23]), v_set(a[7])), x), i, 8);
  for (int step = 4; step; step /= 2) {
    const vi k = v_plus(i, v_at(step - 1));
    i = v_next(v_le(v_choose(high, v_pick16(a + 16, k), v_pick16(a, k)), x), i, step);
  }
  return i;
}

/* Entries of a row of four for each lane, as four vectors. */
V void v_rows(const double *a, vi i, vd *out) {
  long long at[W] __attribute__((aligned(64)));
  v_keep(at, i);
#define ROW(k) _mm256_load_pd(a + 4 * at[k])
#define ROWS(k) _mm512_insertf64x4(_mm512_castpd256_pd512(ROW(k)), ROW(k + 4), 1)
  const vd r0 = ROWS(0), r1 = ROWS(1), r2 = ROWS(2), r3 = ROWS(3);
#undef ROWS
#undef ROW
  const vd low01 = _mm512_unpacklo_pd(r0, r1), high01 = _mm512_unpackhi_pd(r0, r1);
  const vd low23 = _mm512_unpacklo_pd(r2, r3), high23 = _mm512_unpackhi_pd(r2, r3);
  const vi even = _mm512_set_epi64(13, 12, 5, 4, 9, 8, 1, 0), odd = _mm512_set_epi64(15, 14, 7, 6, 11, 10, 3, 2);
  out[0] = _mm512_permutex2var_pd(low01, even, low23);
  out[1] = _mm512_permutex2var_pd(high01, even, high23);
  out[2] = _mm512_permutex2var_pd(low01, odd, low23);
  out[3] = _mm512_permutex2var_pd(high01, odd, high23);
}

#else

enum { W = 4 };
typedef __m256d vd;
typedef __m256d vm; /* all bits of a lane or none */
typedef __m256i vi;

V vd v_set(double a) { return _mm256_set1_pd(a); }
V vd v_load(const double *a) { return _mm256_load_pd(a); }
V void v_store(double *a, vd x) { _mm256_store_pd(a, x); }
V vd v_min(vd a, vd b) { return _mm256_min_pd(a, b); }
V vd v_max(vd a, vd b) { return _mm256_max_pd(a, b); }
V vd v_sqrt(vd a) { return _mm256_sqrt_pd(a); }
V vd v_fabs(vd a) { return _mm256_andnot_pd(v_set(-0.), a); }
V vd v_floor(vd a) { return _mm256_floor_pd(a); }
V vd v_ceil(vd a) { return _mm256_ceil_pd(a); }
V vm v_lt(vd a, vd b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
V vm v_le(vd a, vd b) { return _mm256_cmp_pd(a, b, _CMP_LE_OQ); }
V vm v_eq(vd a, vd b) { return _mm256_cmp_pd(a, b, _CMP_EQ_OQ); }
V vm v_ne(vd a, vd b) { return _mm256_cmp_pd(a, b, _CMP_NEQ_UQ); }
V vm v_all(int a) { return _mm256_castsi256_pd(_mm256_set1_epi64x(a ? -1 : 0)); }
V vm v_not(vm a) { return _mm256_xor_pd(a, v_all(1)); }
V vm v_and(vm a, vm b) { return _mm256_and_pd(a, b); }
V vm v_or(vm a, vm b) { return _mm256_or_pd(a, b); }
V int v_bits(vm a) { return _mm256_movemask_pd(a); }
V vm v_of_bits(int a) {
  const vi lane = _mm256_set_epi64x(8, 4, 2, 1);
  return _mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_and_si256(_mm256_set1_epi64x(a), lane), lane));
}
V vd v_choose(vm m, vd a, vd b) { return _mm256_blendv_pd(b, a, m); }
V vd v_only(vm m, vd a) { return _mm256_and_pd(m, a); }

V vi v_at(long i) { return _mm256_set1_epi64x(i); }
V vi v_plus(vi a, vi b) { return _mm256_add_epi64(a, b); }
V vi v_times(vi a, int b) { return _mm256_mul_epu32(a, _mm256_set1_epi64x(b)); }
V vi v_next(vm m, vi i, int step) { return v_plus(i, _mm256_and_si256(_mm256_castpd_si256(m), v_at(step))); }
V vi v_trunc(vd a) { return _mm256_cvtepi32_epi64(_mm256_cvttpd_epi32(a)); }
V vi v_lanes(void) { return _mm256_set_epi64x(3, 2, 1, 0); }
V void v_keep(long long *a, vi i) { _mm256_store_si256((__m256i *)a, i); }
V vd v_gather(const double *a, vi i) { return _mm256_i64gather_pd(a, i, 8); }
V vi v_gather_int(const int *a, vi i) { return _mm256_cvtepi32_epi64(_mm256_i64gather_epi32(a, i, 4)); }

/* Here a division takes no longer than to correct a product. */
V vd v_inverse(vd b, vm *special) {
  *special = b;
  return b;
}
V vd v_quotient(vd a, vd b, vd inverse, vm special) {
  (void)inverse, (void)special;
  return a / b;
}
V vd v_ratio(vd a, vd b, vd inverse) {
  (void)inverse;
  return a / b;
}

V vd v_pick8(const double *a, vi i) { return v_gather(a, i); }
V vd v_pick16(const double *a, vi i) { return v_gather(a, i); }
V vd v_pick32(const double *a, vi i) { return v_gather(a, i); }

V vi v_find8(const double *a, vd x) {
  vi i = v_at(0);
  for (int k = 0; k < 7; ++k) i = _mm256_sub_epi64(i, _mm256_castpd_si256(v_le(v_set(a[k]), x)));
  return i;
}
V vi v_find16(const double *a, vd x) {
  vi i = v_at(0);
  for (int k = 0; k < 15; ++k) i = _mm256_sub_epi64(i, _mm256_castpd_si256(v_le(v_set(a[k]), x)));
  return i;
}
V vi v_find32(const double *a, vd x) {
  const vm high = v_le(v_set(a[15]), x);
  vi i = v_next(high, v_at(0), 16);
  i = v_next(v_le(v_choose(high, v_set(a[23]), v_set(a[7])), x), i, 8);
  for (int step = 4; step; step /= 2) i = v_next(v_le(v_gather(a, v_plus(i, v_at(step - 1))), x), i, step);
  return i;
}

V void v_rows(const double *a, vi i, vd *out) {
  long long at[W] __attribute__((aligned(32)));
  v_keep(at, i);
  const vd r0 = v_load(a + 4 * at[0]), r1 = v_load(a + 4 * at[1]), r2 = v_load(a + 4 * at[2]), r3 = v_load(a + 4 * at[3]);
  const vd low01 = _mm256_unpacklo_pd(r0, r1), high01 = _mm256_unpackhi_pd(r0, r1);
  const vd low23 = _mm256_unpacklo_pd(r2, r3), high23 = _mm256_unpackhi_pd(r2, r3);
  out[0] = _mm256_permute2f128_pd(low01, low23, 0x20);
  out[1] = _mm256_permute2f128_pd(high01, high23, 0x20);
  out[2] = _mm256_permute2f128_pd(low01, low23, 0x31);
  out[3] = _mm256_permute2f128_pd(high01, high23, 0x31);
}

#endif

V vd v_number(vm a) { return v_only(a, v_set(1)); }
V vd v_sign(vd a) { return v_choose(v_lt(a, v_set(0)), v_set(-1), v_choose(v_lt(v_set(0), a), v_set(1), a)); }
V vd v_clip(vd x, double low, double high) { return v_min(v_set(high), v_max(v_set(low), x)); }

/* How many of `n` rising numbers `x` has reached: first the bin of `b`, then up to `rounds` of them one by one; `next` ends with NaN. */
V vi v_find(const int *start, const double *next, int bins, int rounds, vd b, vd x) {
  vi i = v_gather_int(start, v_trunc(v_min(v_max(b, v_set(0)), v_set(bins - 1))));
  for (int k = 0; k < rounds; ++k) i = v_next(v_le(v_gather(next, i), x), i, 1);
  return i;
}

/* A table of two axes in a cell, at places along both; and one of three, of `cells` cells a plane.  Between whole planes, which count
   gears, the scalar form takes one alone. */
V vd v_cell(const double *rows, vi cell, vd t, vd s) {
  vd r[4];
  v_rows(rows, cell, r);
  const vd low = r[0] + t * r[1], high = r[2] + t * r[3];
  return low + s * (high - low);
}
V vd v_cells(const double *rows, vi cell, int cells, vi k, vd t, vd s, vd r) {
  const vm here = v_eq(r, v_set(0)), there = v_eq(r, v_set(1)), one = v_or(here, there);
  if (v_bits(one) == v_bits(v_all(1))) return v_cell(rows, v_plus(cell, v_times(v_next(there, k, 1), cells)), t, s);
  const vd low = v_cell(rows, v_plus(cell, v_times(k, cells)), t, s);
  const vd high = v_cell(rows, v_plus(cell, v_times(v_plus(k, v_at(1)), cells)), t, s);
  return v_choose(here, low, v_choose(there, high, low + r * (high - low)));
}

/* A table of one axis whose values each lane has of its own, `apart` numbers from each other. */
V vd v_row(const double *y, int apart, vi i, vd t) {
  const vi at = v_plus(v_times(i, apart), v_lanes());
  const vd low = v_gather(y, at), high = v_gather(y + apart, at);
  return low + t * (high - low);
}

/* What the C library computes is computed by it, one lane after the other: so both ways give the same bits. */
#define V_EACH(call)                                        \
  double r[W] __attribute__((aligned(64))), s[W] __attribute__((aligned(64))); \
  v_store(r, a), v_store(s, b);                             \
  for (int k = 0; k < W; ++k) r[k] = call;                  \
  return v_load(r);
#define V_ONE(name) V vd v_##name(vd a) { const vd b = a; V_EACH(name(r[k])) }
#define V_TWO(name) V vd v_##name(vd a, vd b) { V_EACH(name(r[k], s[k])) }
V_ONE(exp) V_ONE(log) V_ONE(tanh) V_ONE(sin) V_ONE(cos) V_ONE(atan) V_TWO(pow) V_TWO(fmod)
