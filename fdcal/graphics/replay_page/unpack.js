// Returns the arrays that fdcal/graphics/replay.py has packed, by name. The bytes of an array are stored in planes: the
// lowest bytes of all its values, then the second lowest and so on. Integers of four bytes are differences along the first
// axis.
async function unpack(packed) {
  const compressed = Uint8Array.from(atob(packed.bytes), c => c.charCodeAt(0));
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), arrays = {};
  const kinds = {i2: Int16Array, i4: Int32Array, f4: Float32Array, f8: Float64Array};
  let at = 0;
  for (const [name, [kind, shape]] of Object.entries(packed.arrays)) {
    const width = Number(kind[1]), count = shape.reduce((a, b) => a * b, 1), interleaved = new Uint8Array(count * width);
    for (let plane = 0; plane < width; plane++) for (let i = 0; i < count; i++) interleaved[i * width + plane] = bytes[at++];
    const values = arrays[name] = new kinds[kind](interleaved.buffer);
    if (kind == "i4") for (let row = count / shape[0], i = row; i < count; i++) values[i] += values[i - row];
  }
  return arrays;
}
