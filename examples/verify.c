/* Checks a proof that motions of a robot are free of collisions, that pairs of bodies are so over ranges of the joints
 * between them, or that two bodies have a common point.
 * Build:  gcc -std=c11 -O2 verify.c -o verify -lm        Use:  ./verify file.proof
 * It prints "verified: FREE, ..." (exit 0), "verified: COLLIDING, ..." or "refused: why" (exit 1); exit 2: no such file.
 * If pairs may be in contact at ends of motions, it prints "verified: FREE, except for ..." and a line for each contact.
 * If the proof is about ranges, it prints "verified: FREE, ... in ranges", and lines for each pair.
 *
 * The page proof-format.md defines the format and what is checked. All real numbers are enclosed: next to each computed
 * double there is a bound of its distance to the true number, which grows with each rounding by more than the rounding's
 * worst case. A plane is accepted only if the bounds show that it separates. What is assumed: doubles are IEEE 754 ones,
 * rounded to the nearest; sqrt errs by at most one unit in the last place; fma rounds once; frexp, ldexp, fabs and rint
 * are exact. Sines and cosines are summed here and do not come from the library.
 *
 * As the page allows, this program refuses numbers of 2^32 or more (but for limits of values), angles above 1e6, more than
 * 1,000 links, degrees above 31, files over 16 MiB and trees more than 64 deep; and, for its own sake, more than 65536 bodies.
 * So all numbers below stay far from overflow. The bytes of names are not looked at. A common point in a flat hull is
 * accepted only at a vertex, or on an edge if it is exactly there. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(__FAST_MATH__) || FLT_EVAL_METHOD != 0 || DBL_MANT_DIG != 53
#error "plain IEEE doubles are needed"
#endif
#define FOR(i, n) for (int i = 0; i < (n); i++)
#define EACH(i, n) for (size_t i = 0; i < (n); i++)
enum { MAX_DEPTH = 64, MAX_BODIES = 65536, MAX_LINKS = 1000, MAX_DEGREE = 31, MAX_FILE = 1 << 24 };
enum { MAX_SIDES = 8, MAX_CORNERS = 1 << 26 };
_Noreturn static void refuse(const char *why) { printf("refused: %s\n", why), exit(1); }
static void *allocate(size_t count, size_t size) { /* room for one more, and zeros */
    void *p = calloc(count + 1, size);
    return p ? p : (refuse("not enough memory"), p);
}

/* ------------------------------------------------------------------------------------------------------- SHA-256 */
static const uint32_t sha_table[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01,
    0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc,
    0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147,
    0x06ca6351, 0x14292967, 0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08,
    0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208,
    0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
static uint32_t turned(uint32_t x, int a, int b, int c) { /* all rotated to the right */
    return (x >> a | x << (32 - a)) ^ (x >> b | x << (32 - b)) ^ (x >> c | x << (32 - c));
}
static void sha_block(uint32_t h[8], const uint8_t *p) {
    uint32_t w[64], s[8];
    memcpy(s, h, sizeof s);
    FOR(i, 64) {
        if (i < 16) w[i] = (uint32_t)(p[4 * i] << 8 | p[4 * i + 1]) << 16 | (uint32_t)(p[4 * i + 2] << 8 | p[4 * i + 3]);
        else w[i] = w[i - 16] + w[i - 7] + (turned(w[i - 15], 7, 18, 3) ^ w[i - 15] << 29) + /* the third is only shifted */
                    (turned(w[i - 2], 17, 19, 10) ^ w[i - 2] << 22);
        uint32_t a = s[7] + turned(s[4], 6, 11, 25) + ((s[4] & s[5]) ^ (~s[4] & s[6])) + sha_table[i] + w[i];
        uint32_t b = turned(s[0], 2, 13, 22) + ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
        memmove(s + 1, s, 7 * sizeof s[0]);
        s[4] += a, s[0] = a + b;
    }
    FOR(i, 8) h[i] += s[i];
}
static void sha256(const uint8_t *p, size_t n, uint8_t out[32]) {
    uint32_t h[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    uint8_t last[128] = {0};
    size_t rest = n % 64, end = rest < 56 ? 64 : 128;
    for (size_t i = 0; i + 64 <= n; i += 64) sha_block(h, p + i);
    if (rest) memcpy(last, p + (n - rest), rest);
    last[rest] = 0x80;
    EACH(i, 8) last[end - 1 - i] = (uint8_t)((uint64_t)n * 8 >> 8 * i);
    for (size_t i = 0; i < end; i += 64) sha_block(h, last + i);
    FOR(i, 32) out[i] = (uint8_t)(h[i / 4] >> (24 - 8 * (i % 4)));
}

/* -------------------------------------------------------------------- Reading, never beyond the end of a block */
typedef struct { const uint8_t *p; size_t left; } Block;
typedef struct { double v, e; } Num; /* The true number is within e of v. If e is 0, v is the number itself. */
static const uint8_t *bytes(Block *b, size_t n) {
    if (n > b->left) refuse("a block ends too early");
    b->p += n, b->left -= n;
    return b->p - n;
}
static uint64_t whole(const uint8_t *p, int n) {
    uint64_t x = 0;
    while (n-- > 0) x = x << 8 | p[n];
    return x;
}
static unsigned u8(Block *b) { return *bytes(b, 1); }
static uint32_t u32(Block *b) { return (uint32_t)whole(bytes(b, 4), 4); }
static int i16(Block *b) { return (int)(whole(bytes(b, 2), 2) ^ 0x8000) - 0x8000; }
static long i32(Block *b) { return (long)((int64_t)(u32(b) ^ 0x80000000) - 0x80000000LL); }
static void name(Block *b) { bytes(b, (size_t)whole(bytes(b, 2), 2)); }
static size_t counted(Block *b, size_t least) { /* a count of things that take at least so many bytes each */
    size_t n = u32(b);
    if (n > b->left / least) refuse("a count is larger than the block can hold");
    return n;
}
static double plain(const uint8_t *p) {
    union { uint64_t bits; double x; } u = {whole(p, 8)};
    return u.x;
}
static double real(Block *b, double least) {
    double x = plain(bytes(b, 8));
    if (!(fabs(x) < 0x1p32 && x >= least)) refuse("a number is not finite, too large, or negative");
    return x;
}
static double size(Block *b) { return real(b, 0); } /* a margin, radius or deviation */
static void nums(Block *b, Num *x, size_t n) { EACH(i, n) x[i] = (Num){real(b, -INFINITY), 0}; }

/* ----------------------------------------------------------------------- Numbers with bounds of their errors */
/* An upper bound of a sum, product, quotient or root of some (not more than 30) numbers that are not negative, which has
 * been computed with rounding (also with underflow) to x. Then an upper bound of any sum of two. */
static double more(double x) { return x * (1 + 0x1p-47) + 1e-300; }
static double above(double a, double b) { double s = a + b; return s + (fabs(s) * 0x1p-52 + 1e-300); }
static Num num(double v) { return (Num){v, 0}; }
static Num neg(Num a) { return (Num){-a.v, a.e}; }
static double most(Num a) { return more(fabs(a.v) + a.e); }
static double top(Num a) { return above(a.v, a.e); }
static Num add(Num a, Num b) {
    double s = a.v + b.v, t = s - a.v;
    if (a.e == 0 && b.e == 0 && (a.v - (s - t)) + (b.v - t) == 0) return num(s); /* no rounding */
    return (Num){s, more(a.e + b.e + fabs(s) * 0x1p-52)};
}
static Num sub(Num a, Num b) { return add(a, neg(b)); }
static Num mul(Num a, Num b) {
    double p = a.v * b.v;
    if (a.e == 0 && b.e == 0 && (a.v == 0 || b.v == 0 || (fabs(p) > 1e-250 && fma(a.v, b.v, -p) == 0))) return num(p);
    return (Num){p, more(fabs(a.v) * b.e + fabs(b.v) * a.e + a.e * b.e + fabs(p) * 0x1p-52)};
}
static Num divide(Num a, Num b) { /* b is not near 0. The error: (a error + q (b error) + residual of q) / (least abs(b)) */
    double q = a.v / b.v;
    if (a.e == 0 && b.e == 0 && (a.v == 0 || (fabs(a.v) > 1e-200 && fma(q, b.v, -a.v) == 0))) return num(q);
    return (Num){q, more((a.e + (fabs(q) + 1e-300) * (b.e + fabs(b.v) * 0x1p-52)) / (fabs(b.v) - b.e))};
}
static void sine_cosine(Num a, Num *sine, Num *cosine) {
    /* pi/2 = p1 + p2 + p3; p1 and p2 have 33 bits, so that k p1 and k p2 are exact for abs(k) < 2^20 */
    const double p1 = 0x1.921fb544p+0, p2 = 0x1.0b4611a6p-34, k = rint(a.v * 0.63661977236758134);
    const Num p3 = {0x1.3198a2e037073p-69, 2e-37}, one = {1, 0}, tiny = {0, 1e-19};
    if (!(fabs(a.v) <= 1.01e6)) refuse("an angle is too large");
    Num y = sub(sub(sub(a, num(k * p1)), num(k * p2)), mul(num(k), p3)), z = mul(y, y), s = one, c = one;
    if (!(fabs(y.v) + y.e < 0.8)) refuse("an angle is too uncertain");
    for (int n = 9; n > 0; n--) { /* Taylor's series to y^19 and y^18; the rest is below 0.8^20 / 20! < 1e-19 */
        s = sub(one, mul(divide(z, num(2 * n * (2 * n + 1))), s));
        c = sub(one, mul(divide(z, num(2 * n * (2 * n - 1))), c));
    }
    s = add(mul(s, y), tiny), c = add(c, tiny);
    const Num list[5] = {s, c, neg(s), neg(c), s}; /* at the angle y + k pi/2 */
    *sine = list[(long)k & 3], *cosine = list[((long)k & 3) + 1];
}

/* --------------------------------------------------------------------------- Vectors, matrices, poses of them */
static Num dot(const Num *a, const Num *b) { return add(add(mul(a[0], b[0]), mul(a[1], b[1])), mul(a[2], b[2])); }
static double scalar(const Num *a, const Num *b) { return a[0].v * b[0].v + a[1].v * b[1].v + a[2].v * b[2].v; }
static void combine(const Num *a, const Num *b, double s, Num *out) { FOR(i, 3) out[i] = add(a[i], mul(num(s), b[i])); }
/* Upper bounds of the root of the sum of squares, of numbers (part = 1) or of their errors (0); squares may underflow. */
static double squares(const Num *a, int n, double part) {
    double sum = 1e-300;
    FOR(i, n) sum += (part * fabs(a[i].v) + a[i].e) * (part * fabs(a[i].v) + a[i].e);
    return more(sqrt(sum));
}
static double length(const Num *a, int n) { return squares(a, n, 1); }
static double errors(const Num *a, int n) { return squares(a, n, 0); }
static void apply(const Num *m, const Num *v, int transposed, Num *out) { /* out is not v */
    FOR(i, 3) out[i] = dot(transposed ? (Num[3]){m[i], m[i + 3], m[i + 6]} : m + 3 * i, v);
}
static void product(const Num *a, const Num *b, Num *out) {
    FOR(i, 9) out[i] = dot(a + i / 3 * 3, (Num[3]){b[i % 3], b[i % 3 + 3], b[i % 3 + 6]});
}
static void turn_matrix(Num a, Num b, Num s, const Num *u, Num *out) { /* a I + b u u' + s [u], where [u] x = u cross x */
    FOR(i, 3) FOR(j, 3) {
        Num x = mul(b, mul(u[i], u[j])), w = mul(s, u[(6 - i - j) % 3]);
        out[3 * i + j] = i == j ? add(x, a) : (i - j + 3) % 3 == 1 ? add(x, w) : sub(x, w);
    }
}

/* A rotation r and a translation t. The numbers er and et bound the whole errors (of r: the root of the sum of squares),
 * and each single error too. */
typedef struct { Num r[9], t[3]; double er, et; } Pose;
/* The pose a followed, towards the moving end, by b. True rotations have norm 1 and root of squares sqrt(3); so the error
 * of a b is at most eb + ea (1 + eb), and rounding adds less than 3 (2^-53) (sqrt(3) + ea) (sqrt(3) + eb). So errors only
 * add up along a chain, whereas those of single numbers would be multiplied. */
static void compose(const Pose *a, const Pose *b, Pose *out) {
    double lb = length(b->t, 3), rounding = 0x1p-49 * (1 + a->er) * (1 + b->er);
    const double er = out->er = more(b->er + a->er * (1 + b->er) + rounding);
    const double et = out->et = more(a->et + b->et + a->er * lb + rounding * (length(a->t, 3) + lb));
    if (!(er < 1 && et < 0x1p99)) refuse("a pose is too uncertain");
    FOR(i, 9) out->r[i] = (Num){scalar(a->r + i / 3 * 3, (Num[3]){b->r[i % 3], b->r[i % 3 + 3], b->r[i % 3 + 6]}), er};
    FOR(i, 3) out->t[i] = (Num){a->t[i].v + scalar(a->r + 3 * i, b->t), et};
}

/* ------------------------------------------------------------------------------------------------------ The model */
/* A link's kind is 0 (does not move), 1 (turns) or 2 (slides). n: its axis, of length 1 if it turns; len: a bound of the
 * length of the axis as it is given; fixed: F and t. A piece has k points (or balls) in x, or one c and G; far and big are
 * bounds of the points and radii. c, r of a body: the first ball. A pair's key is 2^32 i + j; lower: 1 is i, 2 is j; rule:
 * 1 if contact is allowed at the start of motions, 2 at the end, 3 at both. */
typedef struct { long up, value, group; int kind; double len; Num m, f, n[3]; Pose fixed; } Link;
typedef struct { int kind; double radius, far, big; size_t k; Num *x; } Piece;
typedef struct { long link, group; Num M[9], s[3], c[3]; double r; size_t first, count; } Body;
typedef struct { uint64_t key; double margin, N[3]; int lower; unsigned rule; } Pair;
static Link *links;
static Body *bodies;
static Piece *pieces;
static Pair *pairs, *pair; /* all to check; the one at hand */
static size_t link_count, value_count, body_count, pair_count, hollow_count;
static double *limits; /* two of each value */
static Pose world;
static void scale(Num *x, int n) { /* by a power of 2, so that squares are harmless */
    double largest = 0;
    int k;
    FOR(i, n) largest = fmax(largest, fabs(x[i].v));
    if (largest == 0) refuse("a quaternion, an axis or a normal is zero");
    frexp(largest, &k);
    FOR(i, n) x[i] = (Num){ldexp(x[i].v, -k), x[i].v != 0 && fabs(ldexp(x[i].v, -k)) < 1e-290 ? 1e-300 : 0};
}
static void read_link(Block *b, long index, Link *l) {
    Num q[4], *n = l->n;
    name(b);
    l->up = i32(b), l->kind = (int)u8(b), l->value = i32(b);
    nums(b, &l->m, 1), nums(b, &l->f, 1), nums(b, q, 4), nums(b, l->fixed.t, 3), nums(b, n, 3);
    if (l->up < -1 || l->up >= index || l->kind > 2 || l->value < -1 || (l->kind == 0) != (l->value == -1))
        refuse("a link's number of the link above, kind or value is wrong");
    l->group = l->kind || l->up < 0 ? index : links[l->up].group;
    scale(q, 4); /* F = (w^2 - v.v) / (w^2 + v.v) I + 2 / (...) v v' + 2 w / (...) [v] */
    Num ww = mul(q[0], q[0]), vv = dot(q + 1, q + 1), all = add(ww, vv);
    turn_matrix(divide(sub(ww, vv), all), divide(num(2), all), divide(add(q[0], q[0]), all), q + 1, l->fixed.r);
    l->fixed.er = errors(l->fixed.r, 9), l->len = length(n, 3);
    if (l->kind != 1) return;
    scale(n, 3);
    Num square = dot(n, n), one = {sqrt(square.v), more(square.e + 0x1p-52)}; /* the square is between 1/4 and 3 */
    FOR(k, 3) n[k] = divide(n[k], one);
}

/* One of the balls that hold the piece: its center, placed, and a bound of its radius. */
static double ball_of(const Body *b, const Piece *p, size_t k, Num *center) {
    const Num *x = p->kind == 0 ? p->x + 3 * k : p->kind == 4 ? p->x + 4 * k : p->x;
    Num MG[9];
    apply(b->M, x, 0, center), combine(center, b->s, 1, center);
    if (p->kind == 0 || p->kind == 4) return more(p->radius + (p->kind ? x[3].v : 0));
    product(b->M, x + 3, MG);
    return more(p->radius + length(MG, 9) * (p->kind == 1 ? 1 : 1.4142135623730952));
}
static void first_ball(Body *b) {
    Num x[3];
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    FOR(round, 2) /* first the box, and its middle more or less; then the ball about it */
        for (const Piece *p = pieces + b->first; p < pieces + b->first + b->count; p++) EACH(k, p->k) {
            double r = ball_of(b, p, k, x);
            if (!round) FOR(a, 3) low[a] = fmin(low[a], x[a].v - r), high[a] = fmax(high[a], x[a].v + r);
            if (!round) FOR(a, 3) b->c[a] = num(low[a] / 2 + high[a] / 2);
            combine(x, b->c, -1, x);
            if (round) b->r = fmax(b->r, more(r + length(x, 3)));
        }
}
static void read_body(Block *b, Body *o, size_t first, Num **x) {
    name(b);
    o->link = i32(b);
    unsigned hollow = u8(b);
    if (o->link < -1 || o->link >= (long)link_count || hollow > 1) refuse("a body's link or mark is wrong");
    hollow_count += hollow;
    o->group = o->link < 0 ? -1 : links[o->link].group;
    nums(b, o->M, 9), nums(b, o->s, 3);
    o->first = first, o->count = counted(b, 37);
    if (o->count == 0) refuse("a body has no pieces");
    for (Piece *p = pieces + first; p < pieces + first + o->count; p++) {
        p->kind = (int)u8(b), p->radius = size(b), p->x = *x;
        size_t width = p->kind == 0 ? 3 : p->kind == 4 ? 4 : 12;
        p->k = width == 12 ? 1 : counted(b, 8 * width);
        if (p->kind > 4 || p->k == 0) refuse("a piece is of an unknown kind, or has no points");
        for (; *x < p->x + p->k * width; *x += width) {
            nums(b, *x, width == 4 ? 3 : width);
            p->far = fmax(p->far, length(*x, 3));
            if (width == 4) p->big = fmax(p->big, (*x)[3].v = size(b));
        }
    }
    first_ball(o);
}
static int by_key(const void *a, const void *b) {
    uint64_t x = ((const Pair *)a)->key, y = ((const Pair *)b)->key;
    return (x > y) - (x < y);
}
static Pair *read_named(Block *b, int with_margin) { /* in their order, with a last key that is larger than all others */
    size_t n = counted(b, with_margin ? 16 : 8);
    Pair *list = allocate(n, sizeof *list);
    EACH(k, n) {
        uint64_t i = u32(b), j = u32(b);
        if (i >= j || j >= body_count) refuse("a named pair is not one of two bodies in their order");
        list[k] = (Pair){i << 32 | j, with_margin ? size(b) : 0, {0, 0, 0}, 0, 0};
    }
    qsort(list, n, sizeof *list, by_key);
    for (size_t k = 1; k < n; k++) if (list[k].key == list[k - 1].key) refuse("a pair is named twice");
    list[n].key = UINT64_MAX;
    return list;
}
static void read_pairs(Block *b, size_t limit) {
    Pair *skip = read_named(b, 0);
    double margin = size(b);
    Pair *except = read_named(b, 1);
    size_t room = 64, s = 0, e = 0;
    pairs = allocate(room, sizeof *pairs);
    for (uint32_t i = 0; i < body_count; i++) for (uint32_t j = i + 1; j < body_count; j++) {
        uint64_t key = (uint64_t)i << 32 | j;
        while (skip[s].key < key) s++;
        while (except[e].key < key) e++;
        if (bodies[i].group == bodies[j].group || skip[s].key == key) continue;
        if (++pair_count > limit) continue; /* each pair needs a byte of the proof */
        if (pair_count > room && !(pairs = realloc(pairs, (room *= 2) * sizeof *pairs))) refuse("not enough memory");
        pairs[pair_count - 1] = (Pair){key, except[e].key == key ? except[e].margin : margin, {0, 0, 0}, 0, 0};
    }
    free(skip), free(except);
}
static Pair *find_pair(uint64_t key) {
    Pair wanted = {key, 0, {0, 0, 0}, 0, 0};
    return bsearch(&wanted, pairs, pair_count, sizeof *pairs, by_key);
}
static void read_rules(Block *b) {
    for (size_t n = counted(b, 9); n > 0; n--) {
        const uint64_t i = u32(b), j = u32(b);
        const unsigned ends = u8(b);
        Pair *p = i < j && j < body_count ? find_pair(i << 32 | j) : NULL;
        if (!p || p->rule || ends < 1 || ends > 3) refuse("a rule has no ends, or is about a pair with another or unchecked");
        p->rule = ends;
    }
}
static void read_model(Block b, size_t claim, size_t pair_limit, int with_rules) {
    FOR(i, 9) world.r[i] = num(i % 4 == 0);
    link_count = counted(&b, 107);
    if (link_count > MAX_LINKS) refuse("too many links");
    links = allocate(link_count, sizeof *links);
    EACH(i, link_count) read_link(&b, (long)i, links + i);
    value_count = counted(&b, 18);
    limits = allocate(2 * value_count, sizeof *limits);
    EACH(i, value_count) {
        name(&b);
        FOR(k, 2) if (isnan(limits[2 * i + (size_t)k] = plain(bytes(&b, 8)))) refuse("a limit is not a number");
    }
    EACH(i, link_count) if (links[i].value >= (long)value_count) refuse("a link follows a value that does not exist");
    body_count = counted(&b, 144);
    if (body_count > MAX_BODIES) refuse("too many bodies");
    Num *x = allocate(b.left / 8, sizeof *x); /* room for all points: no more than the block can hold */
    bodies = allocate(body_count, sizeof *bodies);
    pieces = allocate(b.left / 37, sizeof *pieces);
    for (size_t i = 0, first = 0; i < body_count; first += bodies[i++].count) read_body(&b, bodies + i, first, &x);
    read_pairs(&b, pair_limit);
    if (pair_count > pair_limit) refuse("the proof is too short for all pairs, or these are too many");
    if (with_rules && (claim != 3 || b.left)) read_rules(&b);
    if (b.left) refuse("the model has more bytes than it uses");
}

/* An upper bound of n.y for all points y of some pieces, in the frame of their link. */
static double support(const Body *b, size_t first, size_t count, const Num *n) {
    Num a[3], g[3];
    apply(b->M, n, 1, a);
    double all = -INFINITY, ln = length(n, 3), slack = more(errors(a, 3) + length(a, 3) * 0x1p-50);
    for (const Piece *p = pieces + first; p < pieces + first + count; p++) {
        double best = -INFINITY, grow = p->radius * ln;
        const Num *x = p->x, *end = x + (p->kind ? 4 : 3) * p->k;
        if (p->kind == 0 || p->kind == 4) { /* the fast way for many points, with one bound of all their errors */
            if (p->kind == 0) for (; x < end; x += 3) best = scalar(a, x) > best ? scalar(a, x) : best;
            else for (; x < end; x += 4) best = fmax(best, scalar(a, x) + x[3].v * ln);
            grow += slack * p->far + p->big * ln * 0x1p-50;
        } else { /* the support of the ball, cylinder or cone at g */
            apply(x + 3, a, 1, g);
            double flat = length(g, 2), cone = fmax(top(g[2]), above(flat, top(neg(g[2]))));
            best = above(top(dot(a, x)), p->kind == 1 ? length(g, 3) : p->kind == 2 ? above(flat, most(g[2])) : cone);
        }
        all = fmax(all, above(best, more(grow)));
    }
    return above(all, top(dot(n, b->s)));
}

/* -------------------------------------------------------------------------------------------------------- Motions */
typedef struct { const uint8_t *points; int degree; } Motion;
typedef struct { uint64_t k; const Motion *motion; int h; } Time; /* t = k / 2^h in a motion; k is odd or h is 0 */
typedef struct { Num c[3]; double r, A, V, S; } Ball; /* carried from body to body; S: the sum of R_j w_j or abs(n_j) w_j */
static Motion *motions, *motion; /* all; the one at hand */
static double *deviation, *steps, *bends; /* of each value; d max abs(...) and d (d-1) max abs(...) of the motion at hand */
static Pose *cache; /* cache_size times the poses of all links, at the times cached */
static Time *cached;
static size_t cache_size = 1024, plane_count;
static double tightest = INFINITY;
typedef struct { size_t motion; uint64_t key; unsigned end, k; double least; } Contact; /* for t to 2^-k, or from 1 - 2^-k */
static Contact *contacts, *contact; /* all, in order, behind them one of no motion; the first one of the tree at hand */
static size_t contact_count;
static Num control(int k, size_t value) { return num(plain(motion->points + 8 * ((size_t)k * value_count + value))); }
static void start_motion(void) {
    int d = motion->degree;
    EACH(v, value_count) {
        Num step, last = num(steps[v] = bends[v] = 0);
        for (int k = 0; k < d; k++, last = step) {
            step = sub(control(k + 1, v), control(k, v));
            steps[v] = fmax(steps[v], more(d * most(step)));
            if (k) bends[v] = fmax(bends[v], more(d * (d - 1) * most(sub(step, last))));
        }
    }
}
static void local_pose(const Link *l, Num t, Pose *out) { /* from the link to the one above */
    Num work[256], rest = sub(num(1), t), J[9], s, c;
    *out = l->fixed;
    if (!l->kind) return;
    FOR(k, motion->degree + 1) work[k] = control(k, (size_t)l->value);
    for (int r = motion->degree; r > 0; r--) FOR(k, r) work[k] = add(mul(rest, work[k]), mul(t, work[k + 1]));
    Num v = add(mul(l->m, work[0]), l->f);
    if (l->kind == 1) {
        sine_cosine(v, &s, &c);
        turn_matrix(c, sub(num(1), c), s, l->n, J);
        product(l->fixed.r, J, out->r), out->er = errors(out->r, 9);
    } else {
        FOR(i, 3) out->t[i] = add(l->fixed.t[i], mul(v, dot(l->fixed.r + 3 * i, l->n)));
        out->et = errors(out->t, 3);
    }
}
static Num share(uint64_t k, int h) { return (Num){ldexp((double)k, -h), k >> 53 ? ldexp((double)k, -h) * 0x1p-52 : 0}; }
static const Pose *poses(uint64_t k, int h) { /* of all links in the world, at t = k / 2^h */
    while (h > 0 && k % 2 == 0) k /= 2, h--;
    uint64_t mixed = (k * 64 + (uint64_t)h + (uint64_t)(motion - motions) * 0x1000003) * 0x9e3779b97f4a7c15;
    size_t slot = (size_t)(mixed >> 32) % cache_size;
    Pose *out = cache + slot * link_count, local;
    Time *at = cached + slot;
    if (at->motion == motion && at->k == k && at->h == h) return out;
    *at = (Time){k, motion, h};
    Num t = share(k, h);
    EACH(i, link_count)
        local_pose(links + i, t, &local), compose(links[i].up < 0 ? &world : out + links[i].up, &local, out + i);
    return out;
}
static void move_ball(const Link *l, Ball *b, int upwards) { /* to the frame of the link above, or from there */
    Num x[3] = {b->c[0], b->c[1], b->c[2]};
    if (!upwards) combine(x, l->fixed.t, -1, x);
    apply(l->fixed.r, x, !upwards, b->c);
    if (upwards) combine(b->c, l->fixed.t, 1, b->c);
    b->r = more(b->r + errors(b->c, 3)); /* From now on, the ball is about the rounded center. */
    FOR(i, 3) b->c[i].e = 0;
}

/* The sums for A are taken from the upper body to the lower one here: instead of 2 w_j W_j, which counts the joints that
 * turn before j, each joint that turns counts all joints that have been passed. */
static void pass_joint(const Link *l, Ball *b) {
    if (l->kind == 0) return;
    double m = fabs(l->m.v), w = more(m * steps[l->value]), shift = more(m * deviation[l->value]), slide = 0, reach = l->len;
    if (l->kind == 1) {
        Num along = dot(b->c, l->n), off[3];
        FOR(i, 3) off[i] = sub(b->c[i], mul(along, l->n[i])), b->c[i] = mul(along, l->n[i]);
        reach = b->r = more(b->r + length(off, 3));
        b->A = more(b->A + w * (reach * w + 2 * b->S));
    } else {
        FOR(k, motion->degree + 1) slide = fmax(slide, most(add(mul(l->m, control(k, (size_t)l->value)), l->f)));
        b->r = more(b->r + reach * (slide + shift));
    }
    b->A = more(b->A + reach * m * bends[l->value]), b->V = more(b->V + reach * shift), b->S = more(b->S + reach * w);
}
static Ball carried(const Body *lower, const Body *upper) {
    static const Link *down[MAX_LINKS];
    size_t downs = 0;
    Ball ball = {{upper->c[0], upper->c[1], upper->c[2]}, upper->r, 0, 0, 0};
    for (long a = upper->link, b = lower->link; a != b;) /* the larger of the two numbers is not of a link above both */
        if (a < b) down[downs++] = links + b, b = links[b].up;
        else pass_joint(links + a, &ball), move_ball(links + a, &ball, 1), a = links[a].up;
    while (downs-- > 0) move_ball(down[downs], &ball, 0), pass_joint(down[downs], &ball);
    return ball;
}

/* ------------------------------------------------------------------------------------------------------- Contacts */
static int by_place(const void *a, const void *b) { /* by motion, then by pair */
    const Contact *x = a, *y = b;
    if (x->motion != y->motion) return x->motion > y->motion ? 1 : -1;
    return (x->key > y->key) - (x->key < y->key);
}
static int goes_on(const Contact *c, size_t m) { /* Does motion m have this contact all along? Then it has no other one. */
    Contact wanted = {m, c->key, 0, 0, 0};
    const Contact *other = bsearch(&wanted, contacts, contact_count, sizeof *contacts, by_place);
    return other && other->k == 0 && other->end == c->end && other->least == c->least;
}
static int joined(size_t m) { /* Does this motion start where the one before ends? */
    EACH(v, value_count) {
        double start = plain(motions[m].points + 8 * v);
        if (start != plain(motions[m - 1].points + 8 * ((size_t)motions[m - 1].degree * value_count + v))) return 0;
    }
    return 1;
}
static void read_contacts(Block *b, size_t count) {
    contact_count = counted(b, 22);
    contacts = allocate(contact_count, sizeof *contacts);
    for (Contact *c = contacts; c < contacts + contact_count; c++) {
        c->motion = u32(b), c->key = (uint64_t)u32(b) << 32, c->key |= u32(b);
        c->end = u8(b), c->k = u8(b), c->least = real(b, -INFINITY);
        const Pair *p = find_pair(c->key);
        if (!p || c->motion >= count || c->end > 1 || !(p->rule & (c->end + 1))) refuse("no rule allows a contact");
        if (c->k > 63 || !(c->least < p->margin)) refuse("a contact is too short, or its distance is not below the margin");
        const int order = c > contacts ? by_place(c - 1, c) : -1;
        if (order > 0 || (order == 0 && c[-1].end >= c->end)) refuse("contacts are not in order, or are named twice");
        if (order == 0 && (c->k == 0 || c[-1].k == 0)) refuse("two contacts of a motion overlap");
    }
    contacts[contact_count].motion = SIZE_MAX;
    EACH(k, contact_count) {
        const Contact *c = contacts + k;
        const size_t m = c->motion;
        if (c->end == 0 && m > 0 && joined(m) && !goes_on(c, m - 1)) refuse("a contact begins late");
        if (c->end == 1 && m + 1 < count && joined(m + 1) && !goes_on(c, m + 1)) refuse("a contact ends early");
    }
}
static void tell_contacts(void) {
    EACH(k, contact_count) {
        const Contact *c = contacts + k;
        printf("contact: bodies %zu and %zu may %s %.17g m in ", (size_t)(c->key >> 32), (size_t)(c->key & 0xffffffff),
               c->least < 0 ? "overlap by" : "come as near as", fabs(c->least));
        if (c->k) printf("the %s 2^-%u of motion %zu\n", c->end ? "last" : "first", c->k, c->motion);
        else printf("all of motion %zu\n", c->motion);
    }
}

/* --------------------------------------------------------------------------------------------------------- Ranges
 * A pair over ranges is checked like a straight motion from the lower ends to the upper ones, at which each value has its
 * own t. Side v of the box reaches from k / 2^h to (k + 1) / 2^h of the range. B: for each body as the lower one, the
 * bounds of the second derivatives, which are A if only this value moves, at the speed 1; negative if not known yet. */
typedef struct { size_t value; double low, high, B[2]; uint64_t k; int h, whole; } Side;
typedef struct { uint64_t key; double margin; size_t first, count; } Told;
static Side *sides, *side; /* of all pairs; the first one of the pair at hand */
static size_t side_count; /* of the pair at hand */
static int in_ranges;
static size_t corner_count; /* of all boxes with a plane */
static Told *tells; /* all pairs, to be printed at the end */
static size_t tell_count;
static Pose *placed; /* poses of the links between the two bodies, as seen from the common one */
static long path[MAX_LINKS];
static size_t path_count;
static void find_path(long a, long b) { /* the links between two links, each after the one above it, and the common one */
    path_count = 0;
    for (; a != b; path_count++) path[path_count] = a > b ? a : b, *(a > b ? &a : &b) = links[a > b ? a : b].up;
    if (a >= 0) placed[a] = world;
    for (size_t i = 0; i < path_count / 2; i++) {
        const long last = path[path_count - 1 - i];
        path[path_count - 1 - i] = path[i], path[i] = last;
    }
}
static void place_corner(int corner) { /* bit v of the corner counts the v-th side that has a width */
    Pose local;
    EACH(i, path_count) {
        const Link *l = links + path[i];
        Num t = num(0);
        for (int v = 0, bit = 0; v < (int)side_count; v++) {
            const Side *s = side + v;
            const int end = s->low < s->high ? corner >> bit++ & 1 : 0;
            if (l->kind && (long)s->value == l->value && s->low < s->high)
                t = end && s->k + 1 == (s->h == 64 ? 0 : (uint64_t)1 << s->h) ? num(1) : share(s->k + (uint64_t)end, s->h);
        }
        local_pose(l, t, &local), compose(l->up < 0 ? &world : placed + l->up, &local, placed + path[i]);
    }
}
static double bent(int low, const Body *lower, const Body *upper) { /* the sum of B (2 h)^2 / 8 */
    double sum = 0;
    for (Side *s = side; s < side + side_count; s++) if (s->low < s->high) {
        steps[s->value] = 1;
        if (s->B[low] < 0) s->B[low] = carried(lower, upper).A;
        steps[s->value] = 0;
        const double w = ldexp(more(s->high - s->low), -s->h);
        sum = more(sum + s->B[low] * w * w / 8);
    }
    return sum;
}
static int whole_range(const Side *s) { /* Does it hold the limits, or a full turn of all joints that follow it? */
    Num width = sub(num(s->high), num(s->low));
    int turns = 1, halvings = 0;
    EACH(i, path_count) {
        const Link *l = links + path[i];
        if (l->kind == 0 || l->value != (long)s->value || l->m.v == 0) continue;
        if (l->kind != 1) turns = 0;
        while (halvings < 20 && ldexp(l->m.v, halvings) != rint(ldexp(l->m.v, halvings))) halvings++;
        if (ldexp(l->m.v, halvings) != rint(ldexp(l->m.v, halvings))) turns = 0;
    }
    if (turns && width.v - width.e >= ldexp(6.283185307179587, halvings)) return 1; /* this is above 2 pi */
    return s->low <= limits[2 * s->value] && s->high >= limits[2 * s->value + 1];
}

/* ---------------------------------------------------------------------------------------------------------- Trees */
typedef struct { uint64_t k; int h; size_t first[2], count[2]; } Part; /* t from k / 2^h to (k + 1) / 2^h; pieces of i, j */
static Ball bounds[2]; /* with A and V, for each body as the lower one; the radius is negative if not known yet */
static double required(const Part *p) { /* the margin, or in a contact the least distance */
    for (const Contact *c = contact; c->motion == (size_t)(motion - motions) && c->key == pair->key; c++) {
        const uint64_t at = p->h < (int)c->k ? 1 : c->k == 0 ? 0 : p->k >> (p->h - (int)c->k);
        if (p->h >= (int)c->k && at == (c->end ? ((uint64_t)1 << c->k) - 1 : 0)) return c->least;
    }
    return pair->margin;
}
static void check_plane(const Part *p) {
    int low = pair->lower - 1, up = 1 - low;
    const size_t i = pair->key >> 32, j = pair->key & 0xffffffff;
    const Body *lower = bodies + (low ? j : i), *upper = bodies + (low ? i : j);
    char text[200];
    Num N[3] = {num(pair->N[0]), num(pair->N[1]), num(pair->N[2])}, n[3], m[3], x[3], d[3];
    if (bounds[low].r < 0) bounds[low] = carried(lower, upper);
    scale(N, 3), apply(lower->M, N, 0, n), scale(n, 3);
    FOR(a, 3) n[a].e = 0; /* any normal will do, so we take a multiple of the rounded one */
    double len = length(n, 3), s = support(lower, p->first[low], p->count[low], n);
    double rest = in_ranges ? bent(low, lower, upper) : more(ldexp(bounds[low].A, -2 * p->h) / 8 + bounds[low].V);
    double need = above(in_ranges ? pair->margin : required(p), rest);
    double right = need < 0 ? len * (1 - 0x1p-40) * need * (1 - 0x1p-40) : more(len * need); /* len is too long by less */
    int places = 2;
    if (in_ranges) places = 1;
    if (in_ranges) EACH(v, side_count) if (side[v].low < side[v].high) places *= 2;
    if (in_ranges && (corner_count += (size_t)places) > MAX_CORNERS) refuse("the boxes have more than 2^26 corners");
    FOR(end, places) {
        uint64_t k = p->k + (uint64_t)end;
        if (in_ranges) place_corner(end);
        const Pose *all = in_ranges ? placed : end && k == 0 ? poses(1, 0) : poses(k, p->h); /* 2^64 / 2^64 does not fit */
        const Pose *l = lower->link < 0 ? &world : all + lower->link, *u = upper->link < 0 ? &world : all + upper->link;
        apply(l->r, n, 0, x), apply(u->r, x, 1, m), combine(l->t, u->t, -1, d);
        FOR(a, 3) m[a] = neg(m[a]);
        double minus_g = above(top(dot(x, d)), support(upper, p->first[up], p->count[up], m)), left = -above(minus_g, s);
        if (!(left > right)) {
            snprintf(text, sizeof text, "plane %zu (%s %zu, bodies %zu and %zu, t = %.6g): %.9g m, %.9g m are needed",
                     plane_count, in_ranges ? "corner" : "motion", in_ranges ? (size_t)end : (size_t)(motion - motions), i, j,
                     in_ranges ? 0 : ldexp((double)p->k + end, -p->h), left / len, need);
            refuse(text);
        }
        tightest = fmin(tightest, (left - right) / len);
    }
    plane_count++;
}
static void tree(Block *b, Part p, int depth) {
    Part q = p;
    unsigned token = u8(b), w = token == 2;
    if (depth > MAX_DEPTH || token > 19) refuse("a tree is too deep, or has an unknown token");
    if (token == 0 && in_ranges) {
        const size_t v = u8(b);
        if (v >= side_count) refuse("a box has no such value");
        const Side before = side[v];
        side[v].k *= 2, side[v].h++, tree(b, q, depth + 1), side[v].k++, tree(b, q, depth + 1);
        side[v].k = before.k, side[v].h = before.h;
    } else if (token == 0) {
        q.k *= 2, q.h++, tree(b, q, depth + 1), q.k++, tree(b, q, depth + 1);
    } else if (token <= 2) {
        q.count[w] /= 2;
        if (q.count[w] == 0) refuse("a single piece is divided");
        tree(b, q, depth + 1), q.first[w] += q.count[w], q.count[w] = p.count[w] - q.count[w];
        tree(b, q, depth + 1);
    } else {
        int way = ((int)token + 2) % 6; /* x, y, z, -x, -y, -z */
        if (token > 3) pair->lower = token <= 9 || token == 16 || token == 18 ? 1 : 2;
        if (token > 3) FOR(i, 3)
            pair->N[i] = token >= 18 ? real(b, -INFINITY) : token >= 16 ? i16(b) : way % 3 != i ? 0 : way < 3 ? 1 : -1;
        if (pair->lower == 0) refuse("no plane has been named before");
        check_plane(&p);
    }
}
static void check_motions(Block *b, int with_contacts) {
    deviation = allocate(3 * value_count, sizeof *deviation);
    steps = deviation + value_count, bends = steps + value_count;
    EACH(i, value_count) deviation[i] = size(b);
    size_t n = counted(b, 1);
    motions = allocate(n, sizeof *motions);
    for (motion = motions; motion < motions + n; motion++) {
        motion->degree = (int)u8(b), motion->points = b->p;
        if (motion->degree == 0 || motion->degree > MAX_DEGREE) refuse("a motion of degree 0, or above 31");
        EACH(k, ((size_t)motion->degree + 1) * value_count) real(b, -INFINITY);
    }
    contacts = allocate(1, sizeof *contacts), contacts->motion = SIZE_MAX;
    if (with_contacts) read_contacts(b, n);
    contact = contacts;
    if (n == 0 || pair_count > b->left / n) refuse(n ? "the proof is too short for all pairs" : "a proof without motions");
    while (cache_size > 1 && cache_size * link_count * sizeof *cache > MAX_FILE) cache_size /= 2;
    cache = allocate(cache_size * link_count, sizeof *cache), cached = allocate(cache_size, sizeof *cached);
    for (motion = motions; motion < motions + n; motion++) {
        start_motion();
        for (pair = pairs; pair < pairs + pair_count; pair++) {
            const Body *o = bodies + (pair->key >> 32), *q = bodies + (pair->key & 0xffffffff);
            bounds[0].r = bounds[1].r = -1;
            const Contact here = {(size_t)(motion - motions), pair->key, 0, 0, 0};
            while (by_place(contact, &here) < 0) contact++;
            tree(b, (Part){0, 0, {o->first, q->first}, {o->count, q->count}}, 0);
        }
    }
    if (b->left) refuse("the proof has more bytes than it uses");
    printf("verified: FREE, ");
    if (contact_count) printf("except for %zu contacts, ", contact_count);
    printf("%zu motions, %zu pairs, %zu planes, tightest %.3g m", n, pair_count, plane_count, tightest);
}

static void check_ranges(Block *b) {
    const size_t n = counted(b, 17);
    Told *told = allocate(n, sizeof *told);
    Pair own = {0, 0, {0, 0, 0}, 0, 0};
    Motion ends = {NULL, 1};
    uint8_t *numbers = allocate(2 * value_count, 8);
    if (n == 0) refuse("a proof without pairs");
    side = sides = allocate(b->left / 16, sizeof *sides), placed = allocate(link_count, sizeof *placed);
    steps = allocate(3 * value_count, sizeof *steps), bends = steps + value_count, deviation = bends + value_count;
    motions = motion = &ends, ends.points = numbers, pair = &own, in_ranges = 1;
    for (Told *t = told; t < told + n; t++) {
        const uint64_t i = u32(b), j = u32(b);
        int open = 0;
        own = (Pair){i << 32 | j, size(b), {0, 0, 0}, 0, 0};
        if (i >= j || j >= body_count || (t > told && t[-1].key >= own.key)) refuse("a pair is out of order");
        const Body *o = bodies + i, *q = bodies + j;
        find_path(o->link, q->link), side_count = 0, memset(numbers, 0, 16 * value_count);
        EACH(v, value_count) {
            int between = 0;
            EACH(k, path_count) {
                const Link *l = links + path[k];
                between |= l->kind && l->value == (long)v && l->m.v != 0;
            }
            if (!between) continue;
            Side *s = side + side_count++;
            memcpy(numbers + 8 * v, b->p, b->left < 16 ? 0 : 8);
            memcpy(numbers + 8 * (value_count + v), b->p + 8, b->left < 16 ? 0 : 8);
            *s = (Side){v, real(b, -INFINITY), 0, {-1, -1}, 0, 0, 0};
            s->high = real(b, s->low), s->whole = whole_range(s), open += s->low < s->high;
        }
        if (open > MAX_SIDES) refuse("a box has more sides than this program takes");
        bounds[0].r = bounds[1].r = -1;
        tree(b, (Part){0, 0, {o->first, q->first}, {o->count, q->count}}, 0);
        *t = (Told){own.key, own.margin, (size_t)(side - sides), side_count};
        side += side_count;
    }
    if (b->left) refuse("the proof has more bytes than it uses");
    printf("verified: FREE, %zu pairs in ranges, %zu planes, tightest %.3g m", n, plane_count, tightest);
    tells = told, tell_count = n;
}
static void tell_ranges(void) {
    for (const Told *t = tells; t < tells + tell_count; t++) {
        printf("pair: bodies %zu and %zu are farther apart than %.17g m\n", (size_t)(t->key >> 32),
               (size_t)(t->key & 0xffffffff), t->margin);
        for (const Side *s = sides + t->first; s < sides + t->first + t->count; s++)
            printf("    for value %zu from %.17g to %.17g, %sall of its range\n", s->value, s->low, s->high,
                   s->whole ? "" : "NOT ");
    }
}

/* -------------------------------------------------------------------------------------------------- Common points */
static int at_most(Num a, Num b) { Num d = sub(b, a); return d.v >= d.e; } /* surely a <= b */
static void cross(const Num *a, const Num *b, Num *out) {
    FOR(i, 3) out[i] = sub(mul(a[(i + 1) % 3], b[(i + 2) % 3]), mul(a[(i + 2) % 3], b[(i + 1) % 3]));
}

/* x of the body's frame, minus y, in the world, in which no link moves. Without y, x is only a direction. */
static void to_world(const Body *b, const Num *x, const Num *y, Num *out) {
    Num z[3];
    apply(b->M, x, 0, out);
    if (y) combine(out, b->s, 1, out);
    for (long l = b->link; l >= 0; l = links[l].up) {
        memcpy(z, out, sizeof z);
        apply(links[l].fixed.r, z, 0, out);
        if (y) combine(out, links[l].fixed.t, 1, out);
    }
    if (y) combine(out, y, -1, out);
}

/* Is the distance of the origin from the points between a and b surely at most the root of r2? */
static int near_segment(const Num *a, const Num *b, Num r2) {
    Num ab[3], x[3];
    combine(b, a, -1, ab), cross(a, ab, x);
    Num square = dot(ab, ab);
    return at_most(dot(a, a), r2) || at_most(dot(b, b), r2) || (square.v > square.e && at_most(dot(a, ab), num(0)) &&
           at_most(num(0), dot(b, ab)) && at_most(dot(x, x), mul(r2, square)));
}
static int belongs(const Body *b, const Piece *p, const uint32_t at[4], const Num *point) {
    Num d[4][3], u[3], x[3], zero = num(0), radius = num(p->radius);
    if (p->kind == 0 || p->kind == 4) FOR(i, 4) {
        if (at[i] >= p->k) refuse("a vertex does not exist");
        to_world(b, p->x + at[i] * (p->kind ? 4 : 3), point, d[i]);
    } else { /* c, and the columns of G */
        if (p->radius > 0 || at[0] || at[1] || at[2] || at[3]) refuse("a radius, or a number, is not 0");
        to_world(b, p->x, point, d[0]);
        FOR(i, 3) to_world(b, (Num[3]){p->x[3 + i], p->x[6 + i], p->x[9 + i]}, NULL, d[1 + i]);
    }
    if (p->kind == 4) return radius = add(radius, p->x[4 * at[0] + 3]), at_most(dot(d[0], d[0]), mul(radius, radius));
    if (p->kind == 0 && near_segment(d[0], d[1], mul(radius, radius))) return 1;
    FOR(i, 16) if (p->kind == 0 && near_segment(d[i / 4], d[i % 4], zero)) return 1; /* exactly on an edge, or at a vertex */
    if (p->kind == 0) FOR(i, 3) combine(d[i + 1], d[0], -1, d[i + 1]);
    FOR(i, 3) /* The solution of d[0] + u[0] d[1] + u[1] d[2] + u[2] d[3] = 0, times the determinant of the last three */
        cross(d[1 + (i + 1) % 3], d[1 + (i + 2) % 3], x), u[i] = neg(dot(d[0], x));
    Num det = dot(d[3], x), rest, flat = add(mul(u[0], u[0]), mul(u[1], u[1])), square = mul(det, det);
    if (fabs(det.v) <= det.e) return 0;
    if (det.v < 0) det = neg(det), u[0] = neg(u[0]), u[1] = neg(u[1]), u[2] = neg(u[2]);
    rest = sub(det, u[2]);
    if (p->kind == 1) return at_most(add(flat, mul(u[2], u[2])), square);
    if (p->kind) return at_most(zero, rest) && at_most(neg(det), u[2]) &&
                        (p->kind == 2 ? at_most(flat, square) : at_most(mul(num(4), flat), mul(rest, rest)));
    return at_most(zero, u[0]) && at_most(zero, u[1]) && at_most(zero, u[2]) && at_most(add(u[0], u[1]), rest);
}
static void check_point(Block *b) {
    uint32_t at[2][6];
    Num point[6];
    EACH(i, link_count) if (links[i].kind) refuse("a link moves, in a proof of a common point");
    FOR(i, 2) {
        FOR(k, 6) at[i][k] = u32(b);
        if (at[i][0] >= body_count || at[i][1] >= bodies[at[i][0]].count) refuse("a body or a piece does not exist");
    }
    if (at[0][0] == at[1][0]) refuse("a common point of a body with itself");
    nums(b, point, 6), combine(point, point + 3, 1, point);
    if (b->left) refuse("the proof has more bytes than it uses");
    FOR(i, 2) if (!belongs(bodies + at[i][0], pieces + bodies[at[i][0]].first + at[i][1], at[i] + 2, point))
        refuse("the common point is not shown to belong to both pieces");
    printf("verified: COLLIDING, bodies %zu and %zu have a common point", (size_t)at[0][0], (size_t)at[1][0]);
}

/* ------------------------------------------------------------------------------------------------------- The file */
int main(int argc, char **argv) {
    static uint8_t data[MAX_FILE + 1], hash[32];
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    size_t n = file ? fread(data, 1, sizeof data, file) : 0;
    if (!file || ferror(file)) return fprintf(stderr, "cannot read the file; use: verify file.proof\n"), 2;
    if (fclose(file), n > MAX_FILE) refuse("a file over 16 MiB");
    Block all = {data, n};
    if (memcmp(bytes(&all, 8), "LOEWNERP", 8) != 0) refuse("not a proof");
    const size_t version = u32(&all), kind = u32(&all), model_size = u32(&all), proof_size = u32(&all);
    const int known = (version == 1 && (kind == 1 || kind == 2)) || (version == 2 && (kind == 1 || kind == 3));
    if (!known) refuse("the version or the claim is unknown");
    if ((uint64_t)model_size + proof_size + 32 != all.left) refuse("a length is wrong");
    sha256(data, n - 32, hash);
    if (memcmp(hash, data + n - 32, 32) != 0) refuse("the file's hash is wrong");
    Block model = {bytes(&all, model_size), model_size}, proof = {bytes(&all, proof_size), proof_size};
    read_model(model, kind, kind == 1 ? proof_size : MAX_FILE, version == 2);
    kind == 1 ? check_motions(&proof, version == 2) : kind == 2 ? check_point(&proof) : check_ranges(&proof);
    if (hollow_count) printf(", %zu bodies with interiors that are not covered", hollow_count);
    sha256(model.p, model_size, hash);
    FOR(i, 32) printf("%s%02x%s", i ? "" : ", model ", hash[i], i < 31 ? "" : "\n");
    tell_contacts(), tell_ranges();
    return kind == 2;
}
