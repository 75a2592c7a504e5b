/* The loops over cells, W at a time, for cell_api.h.
 *
 * One of volume_pointwise.h, volume_mean.h and volume_pressure.h precedes this file and defines how the
 * element treats the material's volume term:
 *   VolumeTerm ................ its data for W cells
 *   volume_prepare ............ compute them at the displacement
 *   volume_parameters ......... the material's parameters at a point, with the pressure
 *   volume_energy_density ..... the energy density beside the material's
 *   volume_residual_point, volume_residual_add .... the residual beside B^T P
 *   volume_jacobian_point, volume_jacobian_add .... the Jacobian beside B^T C B */

/* Per batch of W cells: gather coordinates x and displacements v and prepare the volume term. The body and
 * its closing brace follow. */
#define FOR_EACH_BATCH                                         \
  for (long start = 0; start < c->cells; start += W) {         \
    const int lanes = c->cells - start < W ? c->cells - start : W; \
    real x[GEOMETRY_NODES][3], v[NODES][3];                    \
    VolumeTerm volume;                                           \
    GATHER(x, GEOMETRY_NODES, 3, c->geometry, c->x)            \
    GATHER(v, NODES, 3, c->nodes, u)                           \
    volume_prepare(c, start, x, v, pressure, &volume);

/* Per quadrature point: basis gradients G, weight, H, F and the material's parameters p. The body and its
 * closing brace follow. */
#define FOR_EACH_POINT                                         \
  real G[3 * NODES], weight, F[9], H[9];                           \
  for (int q = 0; q < POINTS; ++q) {                           \
    geometry_point(c, x, q, G, &weight);                       \
    deformation_point(G, v, F, H);                             \
    const Parameters p = volume_parameters(c, &volume, q);

double energy_cells(const Cells *c, const double *u, const double *pressure) {
  double total = 0;
  FOR_EACH_BATCH
    real sum = splat(0), psi;
    FOR_EACH_POINT
      energy_point(p, F, H, &psi);
      sum += (psi + volume_energy_density(p, &volume, F)) * weight;
    }
    for (int l = 0; l < lanes; ++l) total += sum[l];
  }
  return total;
}

void residual_cells(const Cells *c, const double *u, const double *pressure, double *r, double *r_p) {
  FOR_EACH_BATCH
    real P[9], f[NODES][3];
    for (int a = 0; a < NODES; ++a)
      for (int i = 0; i < 3; ++i) f[a][i] = splat(0);
    FOR_EACH_POINT
      stress_point(p, F, H, P);
      for (int i = 0; i < 9; ++i) P[i] *= weight;
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < 3; ++i) f[a][i] += P[i] * G[3 * a] + P[3 + i] * G[3 * a + 1] + P[6 + i] * G[3 * a + 2];
      volume_residual_point(c, &volume, q, p, F, weight);
    }
    for (int l = 0; l < lanes; ++l)
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < 3; ++i) r[3 * (long)c->nodes[NODES * (start + l) + a] + i] += f[a][i][l];
    volume_residual_add(c, start, lanes, &volume, r_p);
  }
}

long jacobian_cells(const Cells *c, const double *u, const double *pressure, int filter, int solver, const MatrixTarget *t) {
  long negative = 0;
  FOR_EACH_BATCH
    real C[81], K[9 * PAIRS];
    for (int i = 0; i < 9 * PAIRS; ++i) K[i] = splat(0);
    FOR_EACH_POINT
      const mask found = hessian_point(p, F, filter, solver, C);
      for (int l = 0; l < lanes; ++l) negative -= found[l];
      add_stiffness(C, G, weight, K);
      volume_jacobian_point(c, &volume, q, p, F, G, weight);
    }
    int constrained = 0;
    real free[NODES][3];
    for (int l = 0; l < lanes; ++l) constrained |= t->constrained[start + l];
    if (constrained) GATHER(free, NODES, 3, c->nodes, t->free)
    volume_jacobian_add(c, t, start, lanes, filter, &volume, K, constrained, free);
    if (constrained) { /* rows and columns of prescribed components are zero */
      real *block = K;
      for (int b = 0; b < NODES; ++b)
        for (int a = 0; a <= b; ++a, block += 9)
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) block[3 * i + j] *= free[a][i] * free[b][j];
    }
    for (int l = 0; l < lanes; ++l)
      scatter(t, c->nodes + NODES * (start + l), t->position + (long)ALL_NODES * ALL_NODES * (start + l), K, l);
  }
  return negative;
}

void fields_cells(const Cells *c, const double *u, const double *pressure, double *fields) {
  FOR_EACH_BATCH
    real out[5] = {splat(0), splat(0), splat(INFINITY), splat(0), splat(INFINITY)};
    FOR_EACH_POINT
      real psi, e[9], Q[9], U[9], V[9], cofactor[9];
      energy_point(p, F, H, &psi);
      eigenvalues_point(p, F, CUBIC, e, Q, U, V);
      const real J = determinant(F, cofactor);
      out[0] += weight;
      out[1] += weight * J;
      out[2] = lane_min(out[2], J);
      out[3] += weight * (psi + volume_energy_density(p, &volume, F));
      for (int k = 0; k < 9; ++k) out[4] = lane_min(out[4], e[k]);
    }
    for (int l = 0; l < lanes; ++l)
      for (int i = 0; i < 5; ++i) fields[5 * (start + l) + i] = out[i][l];
  }
}
