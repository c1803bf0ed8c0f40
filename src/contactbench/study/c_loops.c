/* The particle's kernels as plain C loops: the limit the compiled kernels are compared with.
 *
 * y = (q1, q2, p1, p2), V = |q|^2/2 + c q1^2 q2.  One step is S merged drifts, each phi, keep, lose, and
 * kicks b[0] ... b[S], the last of a step merged with the first of the next. */
#include <stdint.h>

#define KICK(h)                               \
    p1 -= (h) * (q1 + 2 * c * q1 * q2);       \
    p2 -= (h) * (q2 + c * q1 * q1)

#define DRIFT_BY(phi, keep, lose)             \
    q1 += (phi) * p1;                         \
    q2 += (phi) * p2;                         \
    p1 = (keep) * p1 - (lose) * p1;           \
    p2 = (keep) * p2 - (lose) * p2

/* Ensembles: m trajectories, one array per component.  `passes`: every flow a loop over all trajectories;
 * `plain`: drift and kick in one loop; `tiled`: all steps of a tile of trajectories before the next. */
#define R restrict
#define ARGUMENTS                                                                                   \
    int64_t n, double c, const double *b, const double *phi, const double *keep, const double *lose, \
        double *R a1, double *R a2, double *R u1, double *R u2
#define EACH(m, flow)                                            \
    for (int64_t i = 0; i < (m); i++) {                          \
        double q1 = a1[i], q2 = a2[i], p1 = u1[i], p2 = u2[i];   \
        flow;                                                    \
        a1[i] = q1, a2[i] = q2, u1[i] = p1, u2[i] = p2;          \
    }
#define BOTH(first, second) first; second

#define ENSEMBLE(name, S)                                                                              \
    void name##_passes(int64_t m, ARGUMENTS)                                                           \
    {                                                                                                  \
        EACH(m, KICK(b[0]))                                                                            \
        for (int64_t step = 0; step < n; step++)                                                       \
            for (int k = 0; k < S; k++) {                                                              \
                const double h = k < S - 1 ? b[k + 1] : step + 1 < n ? b[S] + b[0] : b[S];             \
                const double f = phi[k], g = keep[k], l = lose[k];                                     \
                EACH(m, DRIFT_BY(f, g, l))                                                               \
                EACH(m, KICK(h))                                                                       \
            }                                                                                          \
    }                                                                                                  \
    void name##_plain(int64_t m, ARGUMENTS)                                                            \
    {                                                                                                  \
        EACH(m, KICK(b[0]))                                                                            \
        for (int64_t step = 0; step < n; step++)                                                       \
            for (int k = 0; k < S; k++) {                                                              \
                const double h = k < S - 1 ? b[k + 1] : step + 1 < n ? b[S] + b[0] : b[S];             \
                const double f = phi[k], g = keep[k], l = lose[k];                                     \
                EACH(m, BOTH(DRIFT_BY(f, g, l), KICK(h)))                                              \
            }                                                                                          \
    }                                                                                                  \
    void name##_tiled(int64_t m, ARGUMENTS)                                                            \
    {                                                                                                  \
        for (int64_t t = 0; t < m; t += TILE)                                                          \
            name##_plain(m - t < TILE ? m - t : TILE, n, c, b, phi, keep, lose, a1 + t, a2 + t, u1 + t, u2 + t); \
    }

#define TILE 256

ENSEMBLE(strang, 1)
ENSEMBLE(rkn6, 11)

/* A ring of n sites, W = r^2/2 + beta r^4/4, S drifts a step.  q has a place for a neighbour before the sites and one
 * after them. */
#define SLOPE(r) ((r) + beta * (r) * (r) * (r))
#define BONDS(h)                                                                       \
    q[-1] = q[n - 1], q[n] = q[0];                                                     \
    for (int64_t i = 0; i < n; i++)                                                    \
        p[i] -= (h) * (SLOPE(q[i] - q[i - 1]) - SLOPE(q[i + 1] - q[i]))

void ring(int64_t n, int64_t steps, int64_t S, double beta, const double *b, const double *phi, const double *keep,
          const double *lose, double *R q, double *R p)
{
    BONDS(b[0]);
    for (int64_t step = 0; step < steps; step++)
        for (int64_t k = 0; k < S; k++) {
            const double h = k < S - 1 ? b[k + 1] : step + 1 < steps ? b[S] + b[0] : b[S];
            for (int64_t i = 0; i < n; i++) {
                q[i] += phi[k] * p[i];
                p[i] = keep[k] * p[i] - lose[k] * p[i];
            }
            BONDS(h);
        }
}
