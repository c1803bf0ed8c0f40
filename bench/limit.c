/* The particle's kernels as plain C loops: the limit the compiled kernels are compared with.
 *
 * y = (q1, q2, p1, p2), V = |q|^2/2 + c q1^2 q2.  One step is S merged drifts, each phi, keep, lose, and
 * kicks b[0] ... b[S], the last of a step merged with the first of the next. */
#include <stdint.h>

#define KICK(h)                               \
    p1 -= (h) * (q1 + 2 * c * q1 * q2);       \
    p2 -= (h) * (q2 + c * q1 * q1)

#define DRIFT(k)                              \
    q1 += phi[k] * p1;                        \
    q2 += phi[k] * p2;                        \
    p1 = keep[k] * p1 - lose[k] * p1;         \
    p2 = keep[k] * p2 - lose[k] * p2

#define LOOP(name, S)                                                                          \
    void name(int64_t n, double c, const double *b, const double *phi, const double *keep,     \
              const double *lose, double *y)                                                   \
    {                                                                                          \
        double q1 = y[0], q2 = y[1], p1 = y[2], p2 = y[3];                                     \
        const double joint = b[S] + b[0];                                                      \
        KICK(b[0]);                                                                            \
        for (int64_t i = 0; i < n; i++) {                                                      \
            for (int k = 0; k < S - 1; k++) {                                                  \
                DRIFT(k);                                                                      \
                KICK(b[k + 1]);                                                                \
            }                                                                                  \
            DRIFT(S - 1);                                                                      \
            const double h = i + 1 < n ? joint : b[S];                                         \
            KICK(h);                                                                           \
        }                                                                                      \
        y[0] = q1, y[1] = q2, y[2] = p1, y[3] = p2;                                            \
    }

LOOP(strang, 1)
LOOP(rkn6, 11)
