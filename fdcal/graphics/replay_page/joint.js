// One step of all free microphones of a plane array at once: the stage "free" of the solver joint
// (fdcal/solvers/robust), on the likelihood of fdcal/cost/likelihood.py with the diffuse kernel:
//
//   C = J0(k |x_i - x_j|) + v tau,    cost = sum over the modes of log det C + q^H C^-1 q
//
// q are the pressures of a mode in unit mean power, v (M) its noise, tau (N) that of the channels. C is real: so are its
// inverse P and all matrices here, in rows of N. A step is damped Gauss-Newton (fdcal/solvers/levenberg_marquardt.py).

// Lower Cholesky factor of a symmetric matrix in place; false where it is not positive definite.
function cholesky(A, N) {
  for (let j = 0; j < N; j++) for (let i = j; i < N; i++) {
    let sum = A[i * N + j];
    for (let l = 0; l < j; l++) sum -= A[i * N + l] * A[j * N + l];
    if (i > j) A[i * N + j] = sum / A[j * N + j];
    else if (sum > 0) A[j * N + j] = Math.sqrt(sum);
    else return false;
  }
  return true;
}
function forward(G, b, N) {  // G^-1 b in place
  for (let i = 0; i < N; i++) {
    for (let l = 0; l < i; l++) b[i] -= G[i * N + l] * b[l];
    b[i] /= G[i * N + i];
  }
  return b;
}
function backward(G, b, N) {  // G^-T b in place
  for (let i = N - 1; i >= 0; i--) {
    for (let l = i + 1; l < N; l++) b[i] -= G[l * N + i] * b[l];
    b[i] /= G[i * N + i];
  }
  return b;
}
function inverse(G, N) {
  const P = new Float64Array(N * N);
  for (let j = 0; j < N; j++) {
    const column = new Float64Array(N);
    column[j] = 1;
    P.set(backward(G, forward(G, column, N), N), j * N);
  }
  return P;
}

// J0(k r) of all pairs of `places`, and its slope over r: -k^2 J1(k r) / (k r).
function diffuse(places, k) {
  const N = places.length, K = new Float64Array(N * N), slope = new Float64Array(N * N), J = new Float64Array(4);
  for (let i = 0; i < N; i++) for (let j = 0; j <= i; j++) {
    const z = k * Math.hypot(places[i][0] - places[j][0], places[i][1] - places[j][1]);
    bessel(z, 0, 1, false, J);
    K[i * N + j] = K[j * N + i] = J[0];
    if (i > j) slope[i * N + j] = slope[j * N + i] = -k * k * (z < 1e-6 ? 0.5 : J[2] / z);
  }
  return {K, slope};
}

class Joint {
  // modes: [{k, re (N), im (N)}] in unit mean power; tau: noise of the channels; free: numbers of those that move
  constructor(modes, tau, free, rules) { Object.assign(this, {modes, tau, free, rules, N: tau.length}); }
  factorised(K, noise) {
    const {N, tau} = this, C = Float64Array.from(K);
    for (let i = 0; i < N; i++) C[i * N + i] += noise * tau[i];
    return cholesky(C, N) ? C : null;
  }
  costOf(G, {re, im}) {
    let cost = 0;
    for (let i = 0; i < this.N; i++) cost += 2 * Math.log(G[i * this.N + i]);
    for (const part of [re, im]) for (const v of forward(G, Float64Array.from(part), this.N)) cost += v * v;
    return cost;
  }
  cost(places, noise) {
    return this.modes.reduce((sum, mode, m) => {
      const G = this.factorised(diffuse(places, mode.k).K, noise[m]);
      return G ? sum + this.costOf(G, mode) : Infinity;
    }, 0);
  }
  // Cost, gradient (F) and Gauss-Newton matrix (F, F) in the coordinates of the free microphones, x and y of each.
  terms(places, noise) {
    const {N, free} = this, F = 2 * free.length, gradient = new Float64Array(F), H = new Float64Array(F * F);
    let cost = 0;
    this.modes.forEach((mode, m) => {
      const {K, slope} = diffuse(places, mode.k), G = this.factorised(K, noise[m]);
      if (!G) { cost = Infinity; return; }
      cost += this.costOf(G, mode);
      const u = [mode.re, mode.im].map(part => backward(G, forward(G, Float64Array.from(part), N), N)), P = inverse(G, N);
      const along = [0, 1].map(() => new Float64Array(F));  // D_a u, real and imaginary
      free.forEach((i, f) => { for (const a of [0, 1]) {
        let re = 0, im = 0, log = 0;
        for (let j = 0; j < N; j++) {
          const d = slope[i * N + j] * (places[i][a] - places[j][a]);
          re += d * u[0][j]; im += d * u[1][j]; log += d * P[i * N + j];
        }
        along[0][2 * f + a] = re; along[1][2 * f + a] = im;
        gradient[2 * f + a] += 2 * (log - re * u[0][i] - im * u[1][i]);
      } });
      for (let f = 0; f < F; f++) for (let g = 0; g < F; g++) {
        H[f * F + g] += 2 * P[free[f >> 1] * N + free[g >> 1]] * (along[0][f] * along[0][g] + along[1][f] * along[1][g]);
      }
    });
    return {cost, gradient, H, F};
  }
  // The noise (M) of greatest likelihood: a share of the power and what an error of all positions adds, on the grid with
  // which fdcal.cost.noise.estimate_noise begins.
  noise(places) {
    const {floor, ceiling, noise_modes} = this.rules, count = this.modes.length, GRID = 8, span = Math.log(ceiling / floor);
    const slopes = this.modes.map(({k}) => k * k / 2), top = Math.max(...slopes), of = (share, variance) => slopes.map(s => Math.min(share + s * variance, ceiling));
    const some = [...new Set(Array.from({length: Math.min(count, noise_modes)}, (_, i, n = Math.min(count, noise_modes)) => n > 1 ? Math.round(i * (count - 1) / (n - 1)) : 0))];
    const kernels = some.map(m => diffuse(places, this.modes[m].k).K);
    let best = null, least = Infinity;
    for (let a = 0; a < GRID; a++) for (let b = 0; b < GRID; b++) {
      const [share, scaled] = [a, b].map(i => floor * Math.exp(span * i / (GRID - 1))), noise = of(share, scaled / top);
      const cost = some.reduce((sum, m, i) => {
        const G = this.factorised(kernels[i], noise[m]);
        return G ? sum + this.costOf(G, this.modes[m]) : Infinity;
      }, 0);
      if (cost < least) { least = cost; best = noise; }
    }
    return best;
  }
  // The places (N, 3) after one step, and how far a coordinate has moved at most, metres; 0 where no step lowers the cost.
  step(places, noise) {
    const {max_step, first_damping, max_damping, min_fall, increase} = this.rules, {cost, gradient, H, F} = this.terms(places, noise);
    const longest = max_step * 2 * Math.PI / Math.max(...this.modes.map(({k}) => k)), diagonal = Array.from(gradient, (_, f) => H[f * F + f]);
    const scale = diagonal.map(v => Math.max(v, 1e-12 * Math.max(...diagonal)));
    for (let damping = this.rules.damping; damping < max_damping; damping = Math.max(damping, first_damping) * increase) {
      const damped = Float64Array.from(H);
      for (let f = 0; f < F; f++) damped[f * F + f] += damping * scale[f];
      if (!cholesky(damped, F)) continue;
      const y = backward(damped, forward(damped, gradient.map(v => -v), F), F), moved = y.reduce((far, v) => Math.max(far, Math.abs(v)), 0);
      const tried = places.map(p => [...p]);
      this.free.forEach((n, f) => { tried[n][0] += y[2 * f]; tried[n][1] += y[2 * f + 1]; });
      if (moved <= longest && this.cost(tried, noise) < cost) return {places: tried, moved};
      if (y.reduce((sum, v, f) => sum - v * gradient[f], 0) < min_fall * Math.abs(cost)) break;
    }
    return {places, moved: 0};
  }
}
