/* The loop over cells for stress_api.h, on cell_batches.h. */

void stresses_cells(const Cells *c, const double *u, const double *pressure, double *weights, double *gradients, double *stresses) {
  const long points = POINTS * (long)c->cells;
  FOR_EACH_BATCH
    FOR_EACH_POINT
      real P[9];
      stress_point(p, F, H, P);
      for (int l = 0; l < lanes; ++l) {
        const long point = POINTS * (long)c->number[cell[l]] + q;
        weights[point] = weight[l] / fraction[l]; /* fields are means over whole cells */
        for (int i = 0; i < 9; ++i) {
          gradients[points * i + point] = H[i][l];
          stresses[points * i + point] = P[i][l];
        }
      }
    }
  }
}
