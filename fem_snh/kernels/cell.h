/* Loops over cells, W at a time: energy, residual, filtered Jacobian, fields of one element.
 *
 * Sizes that the code generator defines: NODES and GEOMETRY_NODES per cell, POINTS per cell.
 * Degrees of freedom are blocked, 3 per node; all node numbers are local to the rank. */

typedef struct {
  int cells;                 /* owned cells */
  const int *nodes;          /* [cells][NODES] nodes of the displacement */
  const int *geometry;       /* [cells][GEOMETRY_NODES] nodes of the geometry */
  const double *x;           /* [.][3] reference coordinates */
  const double *gradients;   /* [POINTS][NODES][3] d(basis)/d(reference coordinates) */
  const double *geometry_gradients; /* [POINTS][GEOMETRY_NODES][3] */
  const double *weights;     /* [POINTS] */
  const double *constants;   /* of the material */
} Cells;

/* Where element matrices go: into the value arrays of an AIJ matrix's diagonal (0) and off-diagonal
 * (1) blocks, or (2) into rows that another rank owns. */
typedef struct {
  double *values[3];
  const int *stride[3];      /* [nodes] values per row of a node */
  const int *position;       /* [cells][NODES][NODES] 4 * offset of the first value + which block */
  const double *free;        /* [nodes][3] 0 where the displacement is prescribed, else 1 */
  const unsigned char *constrained; /* [cells] whether a node of the cell has a 0 there */
} Target;

/* The reference gradients of the basis at point q of W cells, and the weights of their volumes. */
INLINE void geometry_point(const Cells *c, const real x[GEOMETRY_NODES][3], int q, real *G, real *weight) {
  const double *dx = c->geometry_gradients + 3 * GEOMETRY_NODES * q, *d = c->gradients + 3 * NODES * q;
  real T[9], K[9]; /* T[3 k + i] = dx_i/dxi_k; its columns' cross products make the inverse */
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(0);
      for (int a = 0; a < GEOMETRY_NODES; ++a) sum += x[a][i] * dx[3 * a + k];
      T[3 * k + i] = sum;
    }
  cross(T + 3, T + 6, K);
  cross(T + 6, T, K + 3);
  cross(T, T + 3, K + 6);
  const real det = dot(T, K), inverse = 1 / det;
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i)
      G[3 * a + i] = (K[i] * d[3 * a] + K[3 + i] * d[3 * a + 1] + K[6 + i] * d[3 * a + 2]) * inverse;
  *weight = absolute(det) * c->weights[q];
}

INLINE void deformation_point(const real *G, const real u[NODES][3], real *F) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(i == j);
      for (int a = 0; a < NODES; ++a) sum += u[a][i] * G[3 * a + j];
      F[3 * j + i] = sum;
    }
}

/* Nodal values of W cells; lanes past the last cell repeat it. */
#define GATHER(lanes, count, map, values)                                  \
  for (int l = 0; l < W; ++l) {                                            \
    const long cell = start + l < c->cells ? start + l : c->cells - 1;     \
    for (int a = 0; a < (count); ++a)                                      \
      for (int i = 0; i < 3; ++i)                                          \
        lanes[a][i][l] = (values)[3 * (long)(map)[(count) * cell + a] + i]; \
  }

/* For each batch of W cells: x and u gathered; then the body once per quadrature point, with the
 * gradients G, the weight and F. */
#define FOR_EACH_BATCH                                         \
  for (long start = 0; start < c->cells; start += W) {         \
    const int lanes = c->cells - start < W ? c->cells - start : W; \
    real x[GEOMETRY_NODES][3], v[NODES][3];                    \
    GATHER(x, GEOMETRY_NODES, c->geometry, c->x)               \
    GATHER(v, NODES, c->nodes, u)

#define FOR_EACH_POINT                                         \
  real G[3 * NODES], weight, F[9];                             \
  for (int q = 0; q < POINTS; ++q) {                           \
    geometry_point(c, x, q, G, &weight);                       \
    deformation_point(G, v, F);

/* The integral of psi; +inf if it is infinite anywhere. */
double energy_cells(const Cells *c, const double *u) {
  double total = 0;
  FOR_EACH_BATCH
    real sum = splat(0), psi;
    FOR_EACH_POINT
      energy_point(c->constants, F, &psi);
      sum += psi * weight;
    }
    for (int l = 0; l < lanes; ++l) total += sum[l];
  }
  return total;
}

/* r += the derivative of the energy, at owned and ghost nodes. */
void residual_cells(const Cells *c, const double *u, double *r) {
  FOR_EACH_BATCH
    real P[9], f[NODES][3];
    for (int a = 0; a < NODES; ++a)
      for (int i = 0; i < 3; ++i) f[a][i] = splat(0);
    FOR_EACH_POINT
      stress_point(c->constants, F, P);
      for (int i = 0; i < 9; ++i) P[i] *= weight;
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < 3; ++i) f[a][i] += P[i] * G[3 * a] + P[3 + i] * G[3 * a + 1] + P[6 + i] * G[3 * a + 2];
    }
    for (int l = 0; l < lanes; ++l)
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < 3; ++i) r[3 * (long)c->nodes[NODES * (start + l) + a] + i] += f[a][i][l];
  }
}

enum { PAIRS = NODES * (NODES + 1) / 2 };

/* K += G^T C G * weight, the blocks (a, b) with a <= b one after the other, row-major 3x3. */
INLINE void add_stiffness(const real *C, const real *G, real weight, real *K) {
  real *block = K;
  for (int b = 0; b < NODES; ++b) {
    real T[27]; /* T[9 k + 3 i + j] = sum_l C[(i,k),(j,l)] G_bl */
    const real g0 = G[3 * b] * weight, g1 = G[3 * b + 1] * weight, g2 = G[3 * b + 2] * weight;
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          const real *row = C + 9 * (3 * k + i) + j;
          T[9 * k + 3 * i + j] = row[0] * g0 + row[3] * g1 + row[6] * g2;
        }
    for (int a = 0; a <= b; ++a, block += 9)
      for (int m = 0; m < 9; ++m)
        block[m] += G[3 * a] * T[m] + G[3 * a + 1] * T[9 + m] + G[3 * a + 2] * T[18 + m];
  }
}

/* Add the element matrix of lane l to the global one. */
INLINE void scatter(const Target *t, const int *nodes, const int *position, const real *K, int l) {
  const double *block = (const double *)K + l;
  for (int b = 0; b < NODES; ++b)
    for (int a = 0; a <= b; ++a, block += 9 * W) {
      const int to = position[NODES * a + b], which = to & 3, stride = t->stride[which][nodes[a]];
      double *at = t->values[which] + (to >> 2);
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) at[(long)stride * i + j] += block[W * (3 * i + j)];
      if (a == b) continue;
      const int back = position[NODES * b + a], whose = back & 3, step = t->stride[whose][nodes[b]];
      at = t->values[whose] + (back >> 2);
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) at[(long)step * i + j] += block[W * (3 * j + i)];
    }
}

/* Add the filtered Jacobian; returns the number of quadrature points with a negative eigenvalue. */
long jacobian_cells(const Cells *c, const double *u, int filter, int solver, const Target *t) {
  long negative = 0;
  FOR_EACH_BATCH
    real C[81], K[9 * PAIRS];
    for (int i = 0; i < 9 * PAIRS; ++i) K[i] = splat(0);
    FOR_EACH_POINT
      const mask found = hessian_point(c->constants, F, filter, solver, C);
      for (int l = 0; l < lanes; ++l) negative -= found[l];
      add_stiffness(C, G, weight, K);
    }
    int constrained = 0;
    for (int l = 0; l < lanes; ++l) constrained |= t->constrained[start + l];
    if (constrained) {
      real free[NODES][3], *block = K;
      GATHER(free, NODES, c->nodes, t->free)
      for (int b = 0; b < NODES; ++b)
        for (int a = 0; a <= b; ++a, block += 9)
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) block[3 * i + j] *= free[a][i] * free[b][j];
    }
    for (int l = 0; l < lanes; ++l)
      scatter(t, c->nodes + NODES * (start + l), t->position + (long)NODES * NODES * (start + l), K, l);
  }
  return negative;
}

/* Per cell: {volume, deformed volume, smallest J, energy, smallest eigenvalue of the exact Hessian}. */
void fields_cells(const Cells *c, const double *u, double *fields) {
  FOR_EACH_BATCH
    real out[5] = {splat(0), splat(0), splat(INFINITY), splat(0), splat(INFINITY)};
    FOR_EACH_POINT
      real psi, e[9], Q[9], U[9], V[9], cofactor[3];
      energy_point(c->constants, F, &psi);
      eigenvalues_point(c->constants, F, CUBIC, e, Q, U, V);
      cross(F + 3, F + 6, cofactor);
      const real J = dot(F, cofactor);
      out[0] += weight;
      out[1] += weight * J;
      out[2] = smallest(out[2], J);
      out[3] += weight * psi;
      for (int k = 0; k < 9; ++k) out[4] = smallest(out[4], e[k]);
    }
    for (int l = 0; l < lanes; ++l)
      for (int i = 0; i < 5; ++i) fields[5 * (start + l) + i] = out[i][l];
  }
}
