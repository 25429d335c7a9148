// Computes the cost of moving one microphone, for each mode, as fdcal/cost/maps.py does.
//
// Let W = Q S be the QR decomposition of the dictionary of all microphones except n, and q = Q^H p. The cost with
// microphone n at x is
//   r0 + |p_n - y q|^2 / (1 + |y|^2),    y S = w(x),    r0 = |p - Q q|^2.
// y q and |y|^2 have no wavenumber above 2 k: they are computed at Chebyshev nodes and interpolated onto the lattice.
// Complex numbers are pairs, real part first.

// J_0..J_L(z), or the spherical j_0..j_L(z), of complex z, by Miller's downward recurrence, which is stable. Variables
// with r and i are real and imaginary parts: a of order l + 1, b of order l, c of order l - 1.
function bessel(zr, zi, L, spherical, out) {
  const size = zr * zr + zi * zi, length = Math.sqrt(size);
  out.fill(0);
  if (length < 1e-6) { out[0] = 1; return out; }
  const start = 2 * Math.ceil((Math.max(L, length) + 24 + 4 * Math.cbrt(length)) / 2);
  const ir = zr / size, ii = -zi / size;  // 1 / z
  let ar = 0, ai = 0, br = 1e-60, bi = 0, sumr = 0, sumi = 0, central = 1;
  for (let m = 1; spherical && m <= start / 2; m++) central *= (2 * m - 1) / (2 * m);  // C(2m, m) / 4^m
  for (let l = start; l >= 0; l--) {
    if (l <= L) { out[2 * l] = br; out[2 * l + 1] = bi; }
    if (l % 2 == 0) {  // J_0 + 2 J_2 + 2 J_4 ... = 1;  sum (4m + 1) C(2m, m) / 4^m j_2m = 1
      const weight = spherical ? (2 * l + 1) * central : l ? 2 : 1;
      sumr += weight * br; sumi += weight * bi;
      if (spherical && l) central *= l / (l - 1);
    }
    if (!l) break;
    const factor = spherical ? 2 * l + 1 : 2 * l, fr = factor * ir, fi = factor * ii;
    const cr = fr * br - fi * bi - ar, ci = fr * bi + fi * br - ai;
    ar = br; ai = bi; br = cr; bi = ci;
    if (Math.abs(br) + Math.abs(bi) > 1e150) {
      [ar, ai, br, bi, sumr, sumi] = [ar, ai, br, bi, sumr, sumi].map(v => v * 1e-200);
      for (let i = 0; i <= 2 * L + 1; i++) out[i] *= 1e-200;
    }
  }
  const total = sumr * sumr + sumi * sumi;
  for (let l = 0; l <= L; l++) {
    const re = out[2 * l], im = out[2 * l + 1];
    out[2 * l] = (re * sumr + im * sumi) / total; out[2 * l + 1] = (im * sumr - re * sumi) / total;
  }
  return out;
}

// Number of functions of an expansion of order L: fdcal.cost.eq7.functions.
function functionsOf(kind, L) {
  return kind == "plane" ? 2 * L + 1 : kind == "layer" ? (L + 1) * (L + 2) / 2 : (L + 1) ** 2;
}

// Rows (C, K) of W at points (C, 3) relative to the centre, up to a factor of each column, which does not change the cost.
// kind: "plane", a field of two dimensions; "layer", microphones in a plane, but a field of three dimensions; "space",
// microphones and field of three dimensions.
function rowsOf(points, kr, ki, L, kind) {
  const count = points.length / 3, K = functionsOf(kind, L), rows = new Float64Array(2 * count * K);
  const J = new Float64Array(2 * L + 2), cosines = new Float64Array(L + 1), sines = new Float64Array(L + 1);
  const legendre = new Float64Array((L + 1) ** 2);
  for (let c = 0, at = 0; c < count; c++) {
    const x = points[3 * c], y = points[3 * c + 1], z = kind == "space" ? points[3 * c + 2] : 0;
    const across = Math.hypot(x, y), r = Math.hypot(across, z), angle = Math.atan2(y, x);
    bessel(kr * r, ki * r, L, kind != "plane", J);
    for (let m = 0; m <= L; m++) { cosines[m] = Math.cos(m * angle); sines[m] = Math.sin(m * angle); }
    if (kind == "space") associated(r ? z / r : 1, r ? across / r : 0, L, legendre);
    for (let l = 0; l <= L; l++) {
      if (kind == "plane") {
        for (const m of l ? [-l, l] : [0]) {
          const sine = m < 0 ? -sines[l] : sines[l];
          rows[at++] = J[2 * l] * cosines[l] - J[2 * l + 1] * sine; rows[at++] = J[2 * l] * sine + J[2 * l + 1] * cosines[l];
        }
        continue;
      }
      for (let m = -l; m <= l; m += kind == "layer" ? 2 : 1) {
        const factor = kind == "layer" ? 1 : legendre[l * (L + 1) + Math.abs(m)];
        const cosine = factor * cosines[Math.abs(m)], sine = factor * (m < 0 ? -sines[-m] : sines[m]);
        rows[at++] = J[2 * l] * cosine - J[2 * l + 1] * sine; rows[at++] = J[2 * l] * sine + J[2 * l + 1] * cosine;
      }
    }
  }
  return rows;
}

// Normalised associated Legendre functions of degree l and order m >= 0 at cos, sin of the polar angle: out[l (L + 1) + m].
function associated(cos, sin, L, out) {
  let diagonal = 1;
  for (let m = 0; m <= L; m++) {
    if (m) diagonal *= sin * Math.sqrt((2 * m + 1) / (2 * m));
    let before = 0, here = diagonal;
    for (let l = m; l <= L; l++) {
      out[l * (L + 1) + m] = here;
      const n = l + 1, a = Math.sqrt((4 * n * n - 1) / (n * n - m * m));
      const b = l > m ? Math.sqrt((l * l - m * m) / (4 * l * l - 1)) : 0;
      [before, here] = [here, a * (cos * here - b * before)];
    }
  }
}

// The fit of one mode to all microphones except n: S, q and r0. rows (N, K), p (N), both interleaved.
function fitWithout(rows, p, N, K, n) {
  const M = N - 1, Q = [], S = new Float64Array(2 * K * K), q = new Float64Array(2 * K), residual = new Float64Array(2 * M);
  const others = [...Array(N).keys()].filter(i => i != n);
  others.forEach((i, row) => { residual[2 * row] = p[2 * i]; residual[2 * row + 1] = p[2 * i + 1]; });
  for (let j = 0; j < K; j++) {
    const column = new Float64Array(2 * M);
    others.forEach((i, row) => { column[2 * row] = rows[2 * (i * K + j)]; column[2 * row + 1] = rows[2 * (i * K + j) + 1]; });
    const before = lengthOf(column);
    for (let pass = 0; pass < 2; pass++) for (let i = 0; i < j; i++) if (Q[i]) {  // two passes of Gram-Schmidt make Q orthogonal to rounding, for any W
      const [re, im] = subtractProjection(column, Q[i]);
      S[2 * (i * K + j)] += re; S[2 * (i * K + j) + 1] += im;
    }
    const length = lengthOf(column);
    Q.push(length > 1e-12 * before ? column.map(v => v / length) : null);  // a dependent function adds nothing to the fit
    S[2 * (j * K + j)] = Q[j] ? length : 0;
    if (Q[j]) [q[2 * j], q[2 * j + 1]] = subtractProjection(residual, Q[j]);
  }
  return {S, q, r0: lengthOf(residual) ** 2, K};
}
const lengthOf = values => { let sum = 0; for (const v of values) sum += v * v; return Math.sqrt(sum); };
// Subtracts from a column its projection onto a unit vector, and returns the coefficient of the projection.
function subtractProjection(column, unit) {
  let re = 0, im = 0;
  for (let i = 0; i < unit.length; i += 2) {
    re += unit[i] * column[i] + unit[i + 1] * column[i + 1]; im += unit[i] * column[i + 1] - unit[i + 1] * column[i];
  }
  for (let i = 0; i < unit.length; i += 2) {
    column[i] -= re * unit[i] - im * unit[i + 1]; column[i + 1] -= re * unit[i + 1] + im * unit[i];
  }
  return [re, im];
}

// |y|^2, and the real and imaginary parts of y q, of rows (C, K): three arrays (C,), one after the other.
function predictions(rows, {S, q, K}) {
  const count = rows.length / (2 * K), out = new Float64Array(3 * count), y = new Float64Array(2 * K);
  for (let c = 0; c < count; c++) {
    let h = 0, fr = 0, fi = 0;
    for (let j = 0; j < K; j++) {
      let re = rows[2 * (c * K + j)], im = rows[2 * (c * K + j) + 1];
      for (let i = 0; i < j; i++) {
        const sr = S[2 * (i * K + j)], si = S[2 * (i * K + j) + 1];
        re -= y[2 * i] * sr - y[2 * i + 1] * si; im -= y[2 * i] * si + y[2 * i + 1] * sr;
      }
      const diagonal = S[2 * (j * K + j)], inverse = diagonal ? 1 / diagonal : 0;
      re *= inverse; im *= inverse;
      y[2 * j] = re; y[2 * j + 1] = im;
      h += re * re + im * im; fr += re * q[2 * j] - im * q[2 * j + 1]; fi += re * q[2 * j + 1] + im * q[2 * j];
    }
    out[c] = h; out[count + c] = fr; out[2 * count + c] = fi;
  }
  return out;
}

// Chebyshev nodes on an edge, as many as wavenumbers up to 2 k need, and the matrix (P, C) that interpolates from the
// nodes to places on the edge, -1 to 1.
const nodesOf = count => Array.from({length: count}, (_, i) => Math.cos(Math.PI * (i + 0.5) / count));
const nodeCount = (k, edge) => 2 * Math.ceil((k * edge + 10 + 3 * Math.cbrt(k * edge)) / 2);
function interpolationMatrix(count, places) {
  const nodes = nodesOf(count), matrix = new Float64Array(places.length * count);
  places.forEach((place, i) => nodes.forEach((node, j) => {
    let sum = 1 / count;
    const a = Math.acos(Math.min(Math.max(place, -1), 1)), b = Math.acos(node);
    for (let degree = 1; degree < count; degree++) sum += 2 / count * Math.cos(degree * a) * Math.cos(degree * b);
    matrix[i * count + j] = sum;
  }));
  return matrix;
}

// Costs of a microphone over the search domain on a lattice of `points` along its longer edge, one mode after another.
class Landscapes {
  constructor(maps, arrays, count, arrayDimension, points = Landscapes.POINTS) {
    Object.assign(this, {maps, arrays, N: count, spatial: arrayDimension == 3, matrices: new Map()});
    this.kind = maps.dimension == 2 ? "plane" : this.spatial ? "space" : "layer";
    const edge = maps.shape.map(count => count * maps.step), longest = Math.max(...edge);
    this.step = longest / points;
    this.edge = edge;
    this.corner = maps.origin.map(o => o - maps.step / 2);
    this.shape = edge.map(e => Math.max(Math.round(e / this.step), 2));
    this.places = this.shape.map((count, axis) => Array.from({length: count}, (_, i) => this.corner[axis] + (i + 0.5) * this.step));
  }
  // Pressures (N) of a mode at a state, divided by the gains that the solver estimates, and the scale of each row of W. Both
  // are scaled so that the noise of every channel is 1.
  pressures(index, state) {
    const {pressures, mode_scale, channel_scale, gains, noise} = this.arrays, N = this.N;
    const p = new Float64Array(2 * N), scale = new Float64Array(N).fill(1);
    for (let n = 0; n < N; n++) {
      const unit = mode_scale[index] * channel_scale[n];
      let re = unit * pressures[2 * (index * N + n)], im = unit * pressures[2 * (index * N + n) + 1];
      if (gains) {
        const at = state * N + n, gr = gains[2 * at], gi = gains[2 * at + 1], size = gr * gr + gi * gi;
        scale[n] = 1 / Math.sqrt(noise[at]);
        [re, im] = [(re * gr + im * gi) / size * scale[n], (im * gr - re * gi) / size * scale[n]];
      }
      p[2 * n] = re; p[2 * n + 1] = im;
    }
    return {p, scale};
  }
  matrix(count, axis) {
    const key = `${count} ${axis}`, half = this.edge[axis] / 2, middle = this.corner[axis] + half;
    if (!this.matrices.has(key)) this.matrices.set(key, interpolationMatrix(count, this.places[axis].map(v => (v - middle) / half)));
    return this.matrices.get(key);
  }
  // Cost (ny, nx) of the mode with an index if microphone n is moved and the others are at `positions` (N, 3), metres, and
  // the power of the mode's pressures; both in the unit of the pressures squared. A step of descent also gives `centre`,
  // the centre of the expansion, `weights` (N) of the squared residuals, and `shift`, which is added to the orders. The
  // power has the weights, as in fdcal.cost.maps.mode_powers; the residual of microphone n itself has the weight 1.
  map(index, n, positions, state, {centre, weights, shift = 0} = {}) {
    const {N, kind} = this, L = this.maps.orders[index] + shift, [kr, ki] = this.arrays.wavenumbers.slice(2 * index, 2 * index + 2);
    const K = functionsOf(kind, L), {p, scale} = this.pressures(index, state), roots = (weights ?? Array(N).fill(1)).map(Math.sqrt);
    const power = lengthOf(p.map((v, i) => v * roots[Math.floor(i / 2)])) ** 2;
    roots.forEach((root, i) => { if (i != n) { p[2 * i] *= root; p[2 * i + 1] *= root; scale[i] *= root; } });
    centre ??= [0, 1, 2].map(axis => {
      let sum = 0;
      for (let i = 0; i < N; i++) sum += positions[3 * i + axis];
      return sum / N;
    });
    const rows = rowsOf(positions.map((v, i) => v - centre[i % 3]), kr, ki, L, kind);
    for (let i = 0; i < rows.length; i++) rows[i] *= scale[Math.floor(i / (2 * K))];
    const fit = fitWithout(rows, p, N, K, n), counts = this.edge.map(e => nodeCount(kr, e)), points = [];
    const [xs, ys] = counts.map((count, axis) => nodesOf(count).map(t => this.corner[axis] + this.edge[axis] * (1 + t) / 2 - centre[axis]));
    for (const y of ys) for (const x of xs) points.push(x, y, positions[3 * n + 2] - centre[2]);
    const there = rowsOf(points, kr, ki, L, kind).map(v => v * scale[n]), found = predictions(there, fit);
    const [h, re, im] = [0, 1, 2].map(part => this.interpolate(found.subarray(part * points.length / 3, (part + 1) * points.length / 3), counts));
    const cost = new Float32Array(h.length);
    for (let i = 0; i < cost.length; i++) {
      cost[i] = fit.r0 + ((p[2 * n] - re[i]) ** 2 + (p[2 * n + 1] - im[i]) ** 2) / (1 + Math.max(h[i], 0));
    }
    return {cost, power};
  }
  // Values (ny, nx) on the lattice, from values at cx by cy nodes.
  interpolate(values, [cx, cy]) {
    const [nx, ny] = this.shape, X = this.matrix(cx, 0), Y = this.matrix(cy, 1);
    const half = new Float64Array(cy * nx), out = new Float64Array(ny * nx);
    for (let j = 0; j < cy; j++) for (let i = 0; i < nx; i++) {
      let sum = 0;
      for (let c = 0; c < cx; c++) sum += X[i * cx + c] * values[j * cx + c];
      half[j * nx + i] = sum;
    }
    for (let j = 0; j < ny; j++) for (let c = 0; c < cy; c++) {
      const weight = Y[j * cy + c];
      for (let i = 0; i < nx; i++) out[j * nx + i] += weight * half[c * nx + i];
    }
    return out;
  }
}
Landscapes.POINTS = 120;  // points along the longer edge
Landscapes.FINE = 480;  // for maps of few modes, whose narrow valleys would have false minima on a coarse lattice

// The minima that a map marks, as flat indices, as in fdcal/cost/scale.py. `lowest`: the lowest cost and the local minima
// that fit as well; `others`: the other minima; `count`: number of the local minima that do not lie at an edge. Points
// are added to basins in the order of their cost; where two basins meet, the minimum of the higher one counts if it is
// deeper than `depth`.
function minimaOf(cost, nx, ny, {decades, depth}) {
  const order = Uint32Array.from(cost.keys()).sort((a, b) => cost[a] - cost[b]), basin = new Int32Array(cost.length).fill(-1);
  const high = cost[order[order.length - 1]], below = v => Math.log10(Math.max(v, 1e-300) / high);
  const span = Math.min(decades, -below(cost[order[0]])) || 1, values = Float64Array.from(cost, v => {
    const height = 1 + below(v) / span;
    return height < 0 ? 1e-6 * height : height;  // costs below the scale stay in order, but count as equal
  });
  const survives = new Set(), root = i => {
    while (basin[i] != i) i = basin[i] = basin[basin[i]];
    return i;
  };
  for (const here of order) {
    basin[here] = here;
    const j = Math.floor(here / nx), i = here % nx;
    for (let v = Math.max(j - 1, 0); v <= Math.min(j + 1, ny - 1); v++) for (let u = Math.max(i - 1, 0); u <= Math.min(i + 1, nx - 1); u++) {
      if (basin[v * nx + u] < 0) continue;
      let [one, other] = [root(here), root(v * nx + u)];
      if (one == other) continue;
      if (values[one] < values[other]) [one, other] = [other, one];
      if (values[here] - values[one] > depth) survives.add(one);
      basin[one] = other;
    }
  }
  const inside = here => here % nx > 0 && here % nx < nx - 1 && here >= nx && here < nx * (ny - 1), first = order[0];
  const found = [...survives].filter(here => here != first && inside(here)).sort((a, b) => values[a] - values[b]);
  const fits = here => values[here] <= values[first] + depth;
  return {lowest: [first, ...found.filter(fits)], others: found.filter(here => !fits(here)), count: found.length + inside(first)};
}
