/* The loops over cells for cell_api.h, on cell_batches.h. */

/* The element stiffness K from its integrand at the points. */
#ifdef TENSOR_NODES
#define STIFFNESS_BEGIN
#define STIFFNESS_POINT tensor_stiffness_point(C, I, weight, q, tensor_stiffness_of_points);
#define STIFFNESS_END tensor_stiffness(tensor_stiffness_of_points, K);
#else
#define STIFFNESS_BEGIN for (int i = 0; i < 9 * PAIRS; ++i) K[i] = splat(0);
#define STIFFNESS_POINT { real G[3 * NODES]; basis_gradients(c, q, I, G); add_stiffness(C, G, weight, K); }
#define STIFFNESS_END
#endif

double energy_cells(const Cells *c, const double *u, const double *pressure) {
  double total = 0;
  FOR_EACH_BATCH
    real sum = splat(0), psi;
    FOR_EACH_POINT
      energy_point(p, F, H, &psi);
      sum += (psi + volume_energy_density(c, q, p, &volume, F)) * weight;
    }
    for (int l = 0; l < lanes; ++l) total += sum[l];
  }
  return total;
}

void residual_cells(const Cells *c, const double *u, const double *pressure, double *r, double *r_p) {
  FOR_EACH_BATCH
    real P[9], S[9], f[NODES][3];
    for (int a = 0; a < NODES; ++a)
      for (int i = 0; i < 3; ++i) f[a][i] = splat(0);
    FOR_EACH_POINT
      stress_point(p, F, H, P);
      pull_back(P);
      for (int i = 0; i < 9; ++i) P[i] *= weight;
      to_reference(P, I, S);
      const double *d = c->gradients + 3 * NODES * q;
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < 3; ++i) f[a][i] += along(S, d + 3 * a, i);
      volume_residual_point(c, &volume, q, p, F, H, weight);
    }
    for (int l = 0; l < lanes; ++l)
      for (int a = 0; a < NODES; ++a)
        for (int i = 0; i < COMPONENTS; ++i)
          r[COMPONENTS * (long)c->nodes[NODES * cell[l] + a] + i] += f[a][i][l];
    volume_residual_add(c, cell, lanes, &volume, r_p);
  }
}

long jacobian_cells(const Cells *c, const double *u, const double *pressure, int filter, int solver, const MatrixTarget *t) {
  long negative = 0;
  FOR_EACH_BATCH
    real C[81], K[9 * PAIRS];
    STIFFNESS_BEGIN
    FOR_EACH_POINT
      const mask found = hessian_point(p, F, filter, solver, C);
      for (int l = 0; l < lanes; ++l) negative -= found[l];
      CONDENSE(F, C)
      pull_back_matrix(C);
      STIFFNESS_POINT
      volume_jacobian_point(c, &volume, q, p, F, I, weight);
    }
    STIFFNESS_END
    int constrained = 0;
    real free[NODES][3];
    for (int l = 0; l < lanes; ++l) constrained |= t->constrained[c->number[cell[l]]];
    if (constrained) { GATHER_DISPLACEMENTS(free, c->nodes, t->free) }
    volume_jacobian_add(c, t, cell, lanes, filter, &volume, K, constrained, free);
    if (t->rotation) rotate_blocks(c, t->rotation, cell, K);
    if (constrained) { /* rows and columns of prescribed components are zero */
      real *block = K;
      for (int b = 0; b < NODES; ++b)
        for (int a = 0; a <= b; ++a, block += 9)
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) block[3 * i + j] *= free[a][i] * free[b][j];
    }
    for (int l = 0; l < lanes; ++l) scatter(c, t, cell, K, l);
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
      out[3] += weight * (psi + volume_energy_density(c, q, p, &volume, F));
      for (int k = 0; k < 9; ++k) out[4] = lane_min(out[4], e[k]);
    }
    for (int l = 0; l < lanes; ++l)
      for (int i = 0; i < 5; ++i) fields[5 * (long)c->number[cell[l]] + i] = out[i][l];
  }
}
