// The elastic Hessian product by hand: eight frames to a vector, arrays (T / 8, N, components, 8), two passes, no atomics.
typedef double V __attribute__((vector_size(64)));

static inline void cofactor(const V* f, V* c) {
  c[0] = f[4] * f[8] - f[5] * f[7]; c[1] = f[5] * f[6] - f[3] * f[8]; c[2] = f[3] * f[7] - f[4] * f[6];
  c[3] = f[2] * f[7] - f[1] * f[8]; c[4] = f[0] * f[8] - f[2] * f[6]; c[5] = f[1] * f[6] - f[0] * f[7];
  c[6] = f[1] * f[5] - f[2] * f[4]; c[7] = f[2] * f[3] - f[0] * f[5]; c[8] = f[0] * f[4] - f[1] * f[3];
}

// The entry of d cofactor(F)[D] that belongs to f_i f_j - f_k f_l.
static inline V cross(const V* f, const V* d, int i, int j, int k, int l) {
  return f[i] * d[j] + d[i] * f[j] - f[k] * d[l] - d[k] * f[l];
}

static inline void add(const V* q, const double* w, V* o) {
  for (int r = 0; r < 3; r++) o[r] += q[3 * r] * w[0] + q[3 * r + 1] * w[1] + q[3 * r + 2] * w[2];
}

extern "C" void product(long N, long k, long blocks, const int* neighbours, const double* g, const double* own,
                        const double* volume, const double* m, const int* start, const int* edge, const int* indptr,
                        const int* indices, const double* stiffness, const V* p_all, const V* F_all, V* Q, V* out_all) {
#pragma omp parallel
  for (long b = 0; b < blocks; b++) {
    const V *p = p_all + b * N * 3, *F = F_all + b * N * 9;
    V* out = out_all + b * N * 3;
#pragma omp for schedule(static)
    for (long i = 0; i < N; i++) {
      V d[9] = {}, c[9];
      const V *f = F + 9 * i, *here = p + 3 * i;
      for (long e = i * k; e < (i + 1) * k; e++) {
        const V* there = p + 3 * (long)neighbours[e];
        for (int r = 0; r < 3; r++) {
          V u = there[r] - here[r];
          for (int s = 0; s < 3; s++) d[3 * r + s] += u * g[3 * e + s];
        }
      }
      cofactor(f, c);
      V J = f[0] * c[0] + f[1] * c[1] + f[2] * c[2], inverse = 1.0 / J, along = c[0] * d[0];
      for (int r = 1; r < 9; r++) along += c[r] * d[r];
      double mu = m[2 * i], lam = m[2 * i + 1], v = volume[i];
      V s = v * (lam + mu * inverse * inverse) * along, t = v * (lam * (J - 1.0) - mu * inverse);
      V* q = Q + 9 * i;
      for (int r = 0; r < 9; r++) q[r] = (v * mu) * d[r] + s * c[r];
      q[0] += t * cross(f, d, 4, 8, 5, 7); q[1] += t * cross(f, d, 5, 6, 3, 8); q[2] += t * cross(f, d, 3, 7, 4, 6);
      q[3] += t * cross(f, d, 2, 7, 1, 8); q[4] += t * cross(f, d, 0, 8, 2, 6); q[5] += t * cross(f, d, 1, 6, 0, 7);
      q[6] += t * cross(f, d, 1, 5, 2, 4); q[7] += t * cross(f, d, 2, 3, 0, 5); q[8] += t * cross(f, d, 0, 4, 1, 3);
    }
#pragma omp for schedule(static)
    for (long a = 0; a < N; a++) {
      V o[3] = {};
      add(Q + 9 * a, own + 3 * a, o);
      for (int e = start[a]; e < start[a + 1]; e++) add(Q + 9 * (edge[e] / k), g + 3 * (long)edge[e], o);
      for (int e = indptr[a]; e < indptr[a + 1]; e++)
        for (int r = 0; r < 3; r++) o[r] += stiffness[e] * p[3 * (long)indices[e] + r];
      for (int r = 0; r < 3; r++) out[3 * a + r] = o[r];
    }
  }
}
