/* The numbers of generated C, after <math.h>: those of one car, whose types stand before (ONE_CAR), or of LANES cars
   side by side. steerkit/compiled/c_code.py writes what is computed with them. */
#include <string.h>
#define INLINE static inline __attribute__((always_inline))
#ifdef ONE_CAR
#define LANES 1
typedef long long bits;
INLINE bits bits_of(double a) { bits b; memcpy(&b, &a, 8); return b; }
INLINE double real_of(bits b) { double a; memcpy(&a, &b, 8); return a; }
#define lanes_floor floor
#define lanes_sqrt sqrt
#define lanes_asin asin
#define lanes_acos acos
#define lanes_tanh tanh
#define lanes_exp exp
#define lanes_log log
#else
#if defined(__AVX512F__)
#define LANES 8
#define VECTOR(f, args) _ZGVeN8##args##_##f
#elif defined(__AVX2__)
#define LANES 4
#define VECTOR(f, args) _ZGVdN4##args##_##f
#else
#define LANES 2
#define VECTOR(f, args) _ZGVbN2##args##_##f
#endif
typedef double real __attribute__((vector_size(8 * LANES)));
typedef long long mask __attribute__((vector_size(8 * LANES)));
typedef mask bits;
#define bits_of(a) ((bits)(a))
#define real_of(b) ((real)(b))
INLINE real number(double x) { real r; for (int i = 0; i < LANES; i++) r[i] = x; return r; }
INLINE real select(mask c, real a, real b) { return (real)((c & (mask)a) | (~c & (mask)b)); }
#define NUMBER(x) number(x)
#define NOT(a) (~(a))
#define SELECT(c, a, b) select(c, a, b)
#define ABS(a) ((real)((mask)(a) & 0x7fffffffffffffffLL))
#if defined(__clang__)
#define SHUFFLED(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLED(a, b, ...) __builtin_shuffle(a, b, (mask){__VA_ARGS__})
#endif
#define EXCHANGE(i, j, low, high) \
  { const real a = m[i], b = m[j]; m[i] = SHUFFLED(a, b, low); m[j] = SHUFFLED(a, b, high); }
#if LANES == 8
#define LOW4 0, 1, 2, 3, 8, 9, 10, 11
#define HIGH4 4, 5, 6, 7, 12, 13, 14, 15
#define LOW2 0, 1, 8, 9, 4, 5, 12, 13
#define HIGH2 2, 3, 10, 11, 6, 7, 14, 15
#define LOW1 0, 8, 2, 10, 4, 12, 6, 14
#define HIGH1 1, 9, 3, 11, 5, 13, 7, 15
#elif LANES == 4
#define LOW2 0, 1, 4, 5
#define HIGH2 2, 3, 6, 7
#define LOW1 0, 4, 2, 6
#define HIGH1 1, 5, 3, 7
#else
#define LOW1 0, 2
#define HIGH1 1, 3
#endif
/* LANES numbers of a row for each car become LANES columns for all cars: blocks change places, then their parts */
INLINE void transpose(real *m)
{
#if LANES == 8
  for (int i = 0; i < 4; i++) EXCHANGE(i, i + 4, LOW4, HIGH4)
#endif
#if LANES >= 4
  for (int i = 0; i < LANES; i += 4) { EXCHANGE(i, i + 2, LOW2, HIGH2) EXCHANGE(i + 1, i + 3, LOW2, HIGH2) }
#endif
  for (int i = 0; i < LANES; i += 2) EXCHANGE(i, i + 1, LOW1, HIGH1)
}
INLINE void look_up(const double *table, double count, int width, real i, real *m)
{
  const bits at = __builtin_convertvector(select((i >= 0.0) & (i < count), i, number(count)), bits);
  for (int first = 0; first < width; first += LANES)
  {
    for (int l = 0; l < LANES; l++) memcpy(m + first + l, table + at[l] * width + first, sizeof(real));
    transpose(m + first);
  }
}
#define ROW(name, n, i) real name[width##n]; look_up(table##n, count##n, width##n, i, name)
#define AT(name, column) name[column]
#define BY_LANE(f) INLINE real lanes_##f(real a) \
  { real r; for (int i = 0; i < LANES; i++) r[i] = f(a[i]); return r; }
BY_LANE(floor)
BY_LANE(sqrt)
#ifdef VECTOR_MATHS /* glibc's libmvec: within 4 units in the last place */
#define BY_VECTOR(f) extern real VECTOR(f, v)(real); INLINE real lanes_##f(real a) { return VECTOR(f, v)(a); }
BY_VECTOR(asin) BY_VECTOR(acos) BY_VECTOR(tanh) BY_VECTOR(exp) BY_VECTOR(log)
#else
BY_LANE(asin) BY_LANE(acos) BY_LANE(tanh) BY_LANE(exp) BY_LANE(log)
#endif
#endif
typedef void (*routine)(void *, const double *, double *);
static inline real load(const double *a) { real r; memcpy(&r, a, sizeof r); return r; }
static inline void store(double *a, real r) { memcpy(a, &r, sizeof r); }
#define CALL1(f, a) lanes_##f(a)
#define CALL2(f, a, b) lanes_##f(a, b)
INLINE real signed_by(real a, bits sign) { return real_of(bits_of(a) ^ sign); }
/* a = k pi/2 + r by Cody and Waite's method, exact for |a| < 1e6 and within the rounding of a itself beyond; then
   fdlibm's polynomials in r */
INLINE real reduced(real a, bits *quarter)
{
  const real t = a * 0.63661977236758134308 + 6755399441055744.0, k = t - 6755399441055744.0;
  *quarter = bits_of(t);
  return ((a - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
}
INLINE real sine(real r)
{
  const real z = r * r;
  return r + z * r * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
    + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
}
INLINE real cosine(real r)
{
  const real z = r * r, h = 0.5 * z, w = 1.0 - h;
  return w + (((1.0 - w) - h) + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
    + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
    + z * -1.13596475577881948265e-11))))));
}
INLINE real lanes_sin(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(SELECT((q & 1) != 0, c, s), (q & 2) << 62);
}
INLINE real lanes_cos(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(SELECT((q & 1) != 0, s, c), ((q + 1) & 2) << 62);
}
INLINE real lanes_tan(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  const mask odd = (q & 1) != 0;
  return SELECT(odd, -c, s) / SELECT(odd, s, c);
}
/* the angle of (a, b), 0 <= a <= b: beyond pi/8 from pi/4 on; then fdlibm's polynomial, good to tan(pi/8) and more */
INLINE real octant(real a, real b)
{
  const mask steep = a > 0.41421356237309503 * b;
  const real below = SELECT(steep, a + b, b), r = SELECT(steep, a - b, a) / SELECT(below == 0.0, NUMBER(1.0), below);
  const real z = r * r, w = z * z;
  const real even = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02
    + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
  const real odd = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01
    + w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
  const real less = r * (even + odd);
  return SELECT(steep, 7.85398163397448278999e-01 - ((less - 3.06161699786838301793e-17) - r), r - less);
}
INLINE real lanes_atan2(real y, real x)
{
  const real a = ABS(y), b = ABS(x);
  const mask upright = a > b;
  const real part = octant(SELECT(upright, b, a), SELECT(upright, a, b));
  const real right = SELECT(upright, 1.57079632679489655800 - (part - 6.12323399573676603587e-17), part);
  const real angle = SELECT(x < 0.0, 3.14159265358979311600 - (right - 1.22464679914735320717e-16), right);
  return signed_by(angle, bits_of(y) & (-0x7fffffffffffffffLL - 1));
}
INLINE real lanes_atan(real a)
{
  const real b = ABS(a);
  const mask upright = b > 1.0;
  const real part = octant(SELECT(upright, NUMBER(1.0), b), SELECT(upright, b, NUMBER(1.0)));
  const real angle = SELECT(upright, 1.57079632679489655800 - (part - 6.12323399573676603587e-17), part);
  return signed_by(angle, bits_of(a) & (-0x7fffffffffffffffLL - 1));
}
