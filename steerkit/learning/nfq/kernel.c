/* Full-batch Rprop for small all-sigmoid nets, one thread, single precision.
 *
 * Patterns lie along the vector lanes: BLOCK patterns at a time pass forward and backward through the whole net in
 * buffers that stay in the first-level cache. Gradients gather in one vector a weight, and are emptied into doubles
 * every FLUSH blocks, so that the rounding error does not grow with the batch. Nothing here needs -ffast-math.
 *
 * A net with layers of size[0..layers] lies flat in w: for each layer W [n_out][n_in], then b [n_out].
 * Every function returns 0, or 1 when memory ran out. The caller hands over finite numbers only.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__AVX512F__)
#include <immintrin.h>
#define LANES 16
#define VMIN(a, b) ((vf)_mm512_min_ps((__m512)(a), (__m512)(b)))
#define VMAX(a, b) ((vf)_mm512_max_ps((__m512)(a), (__m512)(b)))
#elif defined(__AVX__)
#include <immintrin.h>
#define LANES 8
#define VMIN(a, b) ((vf)_mm256_min_ps((__m256)(a), (__m256)(b)))
#define VMAX(a, b) ((vf)_mm256_max_ps((__m256)(a), (__m256)(b)))
#else
#define LANES 4
#endif

enum { BLOCK = 128, VECS = BLOCK / LANES, FLUSH = 16, TILE_I = LANES == 16 ? 5 : 2 };

typedef float vf __attribute__((vector_size(4 * LANES)));
typedef unsigned vu __attribute__((vector_size(4 * LANES)));
#define INLINE static inline __attribute__((always_inline))

#ifndef VMIN /* the second operand survives a NaN, as in the x86 instructions */
INLINE vf VMIN(vf a, vf b) { for (int k = 0; k < LANES; k++) b[k] = a[k] < b[k] ? a[k] : b[k]; return b; }
INLINE vf VMAX(vf a, vf b) { for (int k = 0; k < LANES; k++) b[k] = a[k] > b[k] ? a[k] : b[k]; return b; }
#endif

INLINE vf all(float a) { return (vf){0} + a; }

/* 1 / (1 + 2^t), t = -z log2(e) limited to +-60: 2^t = 2^n 2^f, |f| <= 1/2, 2^f by its minimax polynomial of degree 5
 * (relative error 8e-8, 2e-7 after rounding). The result is within 3e-7 + 7e-8 |z| of the true value, relatively, for
 * |z| < 41 (z log2(e) is rounded), and within 2e-7 absolutely. NaN stays NaN. */
INLINE vf sigmoid(vf z) {
    const vf magic = all(12582912.0f); /* 1.5 * 2^23: adding it rounds to a whole number, kept in the low bits */
    const vf t = VMIN(all(60.0f), VMAX(all(-60.0f), z * -1.44269504f));
    const vf s = t + magic, f = t - (s - magic);
    vf p = f * 0.0013276472f + 0.009675542f;
    p = p * f + 0.05550713f;
    p = p * f + 0.2402212f;
    p = p * f + 0.69314694f;
    p = p * f + 1.0000001f;
    const vf d = p * (vf)(((vu)s << 23) + 0x3f800000u) + 1.0f;
#if defined(__AVX512F__)
    const vf r = (vf)_mm512_rcp14_ps((__m512)d);
    return r * (2.0f - d * r); /* one Newton step: 14 bits become 28 */
#else
    return 1.0f / d;
#endif
}

enum { FORWARD, BACKWARD };

/* rows of out = W in (+ b, through the sigmoid), or, backward, out <- (W in) out (1 - out); two vectors a unit. */
INLINE void tile(int kind, int rows, int cols, const float *w, int row, int col, const float *b, const vf *in, vf *out) {
    vf acc[5][2];
    for (int j = 0; j < rows; j++) acc[j][0] = acc[j][1] = kind == FORWARD ? all(b[j]) : all(0.0f);
    for (int i = 0; i < cols; i++) {
        const vf x0 = in[i * VECS], x1 = in[i * VECS + 1];
        for (int j = 0; j < rows; j++) {
            const float a = w[j * row + i * col];
            acc[j][0] += a * x0;
            acc[j][1] += a * x1;
        }
    }
    for (int j = 0; j < rows; j++)
        for (int k = 0; k < 2; k++) {
            vf *y = out + j * VECS + k;
            *y = kind == FORWARD ? sigmoid(acc[j][k]) : acc[j][k] * (*y - *y * *y);
        }
}

INLINE void layer(int kind, int rows, int cols, const float *w, int row, int col, const float *b, const vf *in, vf *out) {
    for (int v = 0; v < VECS; v += 2)
        for (int j = 0; j < rows; j += 5) {
#define ROWS(n) tile(kind, n, cols, w + j * row, row, col, b + j, in + v, out + j * VECS + v)
            switch (rows - j) {
                case 1: ROWS(1); break;
                case 2: ROWS(2); break;
                case 3: ROWS(3); break;
                case 4: ROWS(4); break;
                default: ROWS(5);
            }
#undef ROWS
        }
}

/* g[j][i] += sum over the block of delta[j] in[i], a vector of partial sums each. */
INLINE void outer_tile(int rows, int cols, int stride, const vf *delta, const vf *in, vf *g) {
    vf acc[5][TILE_I];
    for (int j = 0; j < rows; j++)
        for (int i = 0; i < cols; i++) acc[j][i] = g[j * stride + i];
    for (int v = 0; v < VECS; v++)
        for (int j = 0; j < rows; j++)
            for (int i = 0; i < cols; i++) acc[j][i] += delta[j * VECS + v] * in[i * VECS + v];
    for (int j = 0; j < rows; j++)
        for (int i = 0; i < cols; i++) g[j * stride + i] = acc[j][i];
}

static void outer(int rows, int cols, const vf *delta, const vf *in, vf *g) {
    int j = 0;
    for (; j + 5 <= rows; j += 5) {
        int i = 0;
        for (; i + TILE_I <= cols; i += TILE_I)
            outer_tile(5, TILE_I, cols, delta + j * VECS, in + i * VECS, g + j * cols + i);
        for (; i + 2 <= cols; i += 2) outer_tile(5, 2, cols, delta + j * VECS, in + i * VECS, g + j * cols + i);
        for (; i < cols; i++) outer_tile(5, 1, cols, delta + j * VECS, in + i * VECS, g + j * cols + i);
    }
    for (; j < rows; j++) {
        int i = 0;
        for (; i + 5 <= cols; i += 5) /* the tile turned over: one row, five columns */
            outer_tile(5, 1, 1, in + i * VECS, delta + j * VECS, g + j * cols + i);
        for (; i < cols; i++) outer_tile(1, 1, cols, delta + j * VECS, in + i * VECS, g + j * cols + i);
    }
    for (j = 0; j < rows; j++)
        for (int v = 0; v < VECS; v++) g[rows * cols + j] += delta[j * VECS + v];
}

typedef struct {
    int layers, units, weights; /* units: all layers', the inputs included */
    const int *size;
    long n, blocks;
    vf *x, *t, *act, *g; /* inputs [blocks][size[0]][VECS], targets [blocks][VECS], activations, gradient sums */
    double *grad;
} Work;

static void release(Work *k) { free(k->x); free(k->t); free(k->act); free(k->g); free(k->grad); }

static void *room(size_t bytes) {
    void *p = NULL;
    return posix_memalign(&p, 64, bytes ? bytes : 64) ? NULL : memset(p, 0, bytes);
}

/* Lays x [n][size[0]] and t [n] (or NULL) out in blocks; the last one is filled up with zeros. */
static int prepare(Work *k, int layers, const int *size, long n, const float *x, const float *t) {
    memset(k, 0, sizeof *k);
    k->layers = layers, k->size = size, k->n = n, k->blocks = (n + BLOCK - 1) / BLOCK;
    for (int l = 0; l <= layers; l++) k->units += size[l];
    for (int l = 0; l < layers; l++) k->weights += (size[l] + 1) * size[l + 1];
    const int m = size[0];
    k->x = room(sizeof(float) * BLOCK * m * k->blocks);
    k->t = room(sizeof(float) * BLOCK * k->blocks);
    k->act = room(sizeof(float) * BLOCK * k->units);
    k->g = room(sizeof(vf) * k->weights);
    k->grad = room(sizeof(double) * k->weights);
    if (!k->x || !k->t || !k->act || !k->g || !k->grad) return release(k), 1;
    for (long p = 0; p < n; p++)
        for (int i = 0; i < m; i++) ((float *)k->x)[(p / BLOCK * m + i) * BLOCK + p % BLOCK] = x[p * m + i];
    if (t) memcpy(k->t, t, sizeof(float) * n);
    return 0;
}

/* Block c through the net; the output's activations. act holds the layers 1.. one after another. */
static vf *forward(Work *k, const float *w, long c) {
    const vf *in = k->x + c * k->size[0] * VECS;
    vf *out = k->act;
    for (int l = 0;; l++) {
        const int ni = k->size[l], no = k->size[l + 1];
        layer(FORWARD, no, ni, w, ni, 1, w + no * ni, in, out);
        if (l == k->layers - 1) return out;
        w += (ni + 1) * no, in = out, out += no * VECS;
    }
}

/* Block c backward: each layer's activations give way to dE/dz, after they have served the gradient above. */
static void backward(Work *k, const float *w, long c, vf *delta) {
    w += k->weights;
    vf *g = k->g + k->weights;
    for (int l = k->layers - 1; l >= 0; l--) {
        const int ni = k->size[l], no = k->size[l + 1];
        w -= (ni + 1) * no, g -= (ni + 1) * no;
        vf *in = l ? delta - ni * VECS : k->x + c * ni * VECS;
        outer(no, ni, delta, in, g);
        if (l) layer(BACKWARD, ni, no, w, 1, ni, NULL, delta, in);
        delta = in;
    }
}

static void flush(Work *k) {
    for (int i = 0; i < k->weights; i++) {
        for (int a = 0; a < LANES; a++) k->grad[i] += k->g[i][a];
        k->g[i] = all(0.0f);
    }
}

/* E = mean (q - t)^2 at w; with `learn`, also k->grad = dE/dw. */
static double error(Work *k, const float *w, int learn) {
    double sum = 0.0;
    memset(k->grad, 0, sizeof(double) * k->weights);
    for (long c = 0; c < k->blocks; c++) {
        vf *y = forward(k, w, c), square = all(0.0f);
        const long left = k->n - c * BLOCK;
        for (int v = 0; v < VECS; v++) {
            vf miss = y[v] - k->t[c * VECS + v];
            if (left < BLOCK)
                for (int a = 0; a < LANES; a++)
                    if (v * LANES + a >= left) miss[a] = 0.0f; /* filling */
            square += miss * miss;
            y[v] = miss * (y[v] - y[v] * y[v]);
        }
        for (int a = 0; a < LANES; a++) sum += square[a];
        if (!learn) continue;
        backward(k, w, c, y);
        if (c % FLUSH == FLUSH - 1) flush(k);
    }
    flush(k);
    for (int i = 0; i < k->weights; i++) k->grad[i] *= 2.0 / k->n;
    return sum / k->n;
}

/* q[n]: the net's outputs. */
int steerkit_predict(int layers, const int *size, const float *w, long n, const float *x, float *q) {
    Work k;
    if (prepare(&k, layers, size, n, x, NULL)) return 1;
    for (long c = 0; c < k.blocks; c++) {
        const long left = n - c * BLOCK;
        memcpy(q + c * BLOCK, forward(&k, w, c), sizeof(float) * (left < BLOCK ? left : BLOCK));
    }
    release(&k);
    return 0;
}

/* `epochs` steps of Rprop from w, in place; errors[epochs + 1]: E before each step, and after the last.
 * rule: delta_0, eta-, eta+, delta_min, delta_max. */
int steerkit_rprop(int layers, const int *size, float *w, long n, const float *x, const float *t, int epochs,
                   const float *rule, double *errors) {
    Work k;
    if (prepare(&k, layers, size, n, x, t)) return 1;
    float *step = room(2 * sizeof(float) * k.weights), *before = step + k.weights;
    if (!step) return release(&k), 1;
    for (int i = 0; i < k.weights; i++) step[i] = rule[0];
    for (int epoch = 0; epoch < epochs; epoch++) {
        errors[epoch] = error(&k, w, 1);
        for (int i = 0; i < k.weights; i++) {
            float g = (float)k.grad[i];
            const float turn = g * before[i];
            step[i] = fminf(fmaxf(step[i] * (turn > 0.0f ? rule[2] : turn < 0.0f ? rule[1] : 1.0f), rule[3]), rule[4]);
            if (turn < 0.0f) g = 0.0f; /* the minimum was jumped over: wait an epoch */
            w[i] -= g > 0.0f ? step[i] : g < 0.0f ? -step[i] : 0.0f;
            before[i] = g;
        }
    }
    errors[epochs] = error(&k, w, 0);
    free(step);
    release(&k);
    return 0;
}
