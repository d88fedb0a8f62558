// Python bindings of rendering.
#include "bindings.hpp"
#include "raster.hpp"

namespace supple {
namespace {

typedef nb::ndarray<nb::ro, nb::ndim<3>, nb::c_contig, nb::device::cpu> Samples;

// Call `f` with the samples of a volume in their type.
template <class F>
void with_samples(const Samples& samples, F&& f) {
    auto is = [&](auto zero) { return samples.dtype() == nb::dtype<decltype(zero)>(); };
    auto go = [&](auto zero) { f((const decltype(zero)*)samples.data()); };
    if (is(uint8_t())) return go(uint8_t());
    if (is(int8_t())) return go(int8_t());
    if (is(uint16_t())) return go(uint16_t());
    if (is(int16_t())) return go(int16_t());
    if (is(float())) return go(float());
    throw nb::type_error("samples must be uint8, int8, uint16, int16 or float32");
}
typedef std::optional<nb::ndarray<nb::ro, nb::ndim<4>, nb::c_contig, nb::device::cpu>> Colours;

// Call `f` with a volume that interpolates samples: values, labels, or values with colours.
void with_volume(const Samples& samples, const Colours& colours, bool labelled,
                 const std::function<void(const Volume&)>& f) {
    with_samples(samples, [&]<class T>(const T* data) {
        const int64_t nx = samples.shape(2), ny = samples.shape(1), nz = samples.shape(0);
        if constexpr (std::is_unsigned_v<T>) {
            if (labelled) return f(VolumeOf<Labels<T>>({data, nx, ny, nz}));
            if (colours) return f(VolumeOf<Coloured<T>>({data, (const T*)colours->data(), nx, ny, nz}));
        } else if (labelled || colours)
            throw nb::type_error("labels and colours must be uint8 or uint16");
        f(VolumeOf<Voxels<T>>({data, nx, ny, nz}));
    });
}
// The shape of an array (Z, Y, X) as (x, y, z).
template <class A>
std::array<int64_t, 3> sizes(const A& a) {
    return {(int64_t)a.shape(2), (int64_t)a.shape(1), (int64_t)a.shape(0)};
}

Float4 point_of(const float* at) { return Float4{at[0], at[1], at[2], 0}; }

void look_up(Samples samples, Array<const float, -1, 3> points, Array<float, -1, 4> out, bool labelled) {
    with_volume(samples, {}, labelled, [&](const Volume& voxels) {
        Chosen first{};
        first[0] = -1;
        for (size_t i = 0; i < points.shape(0); i++) {
            Triple p, slope;
            p.set(0, point_of(points.data() + 3 * i));
            voxels.slopes(p, first, slope);
            out(i, 0) = voxels.values(p, first)[0];
            for (int c = 0; c < 3; c++) out(i, 1 + c) = slope[c][0];
        }
    });
}

Look* make_look(Array<const double, 5, 3> camera, Solid<const uint8_t> skips, Array<const float, -1, 4> table,
                Array<const double, -1, 4> sums, float low, float scale, float threshold, float top, double step,
                std::array<float, 3> lamp, bool shaded, Array<const double, 2, 3> box, std::array<double, 4> plane,
                float silhouettes, int projection, Solid<const float> arrives, Array<const float, 2, 3> placed,
                bool labelled) {
    auto* look = new Look;
    Double4* rows[] = {&look->eye, &look->spacing, &look->ahead, &look->right, &look->down};
    for (int k = 0; k < 5; k++) *rows[k] = Double4{camera(k, 0), camera(k, 1), camera(k, 2), k == 1 ? 1.0 : 0.0};
    look->per_voxel = floats(Double4(1.0 / look->spacing));
    look->first = Double4{box(0, 0), box(0, 1), box(0, 2), 0};
    look->last = Double4{box(1, 0), box(1, 1), box(1, 2), 0};
    look->step = float(step);
    look->per_step = float(1 / step);
    look->per_layer = float(1 / (LAYER * least(camera(1, 0), least(camera(1, 1), camera(1, 2)))));
    look->lamp = point_of(lamp.data());
    look->shaded = shaded;
    look->plane = Double4{plane[0], plane[1], plane[2], plane[3]};
    look->silhouettes = silhouettes;
    look->labelled = labelled;
    look->projection = decltype(look->projection)(projection);
    look->arrives.assign(arrives.data(), arrives.data() + arrives.size());
    look->nodes = sizes(arrives);
    look->first_node = point_of(placed.data());
    look->per_node = point_of(placed.data() + 3);
    auto [x, y, z] = sizes(skips);
    look->skips.assign(skips.data(), skips.data() + skips.size());
    look->row = int(x);
    look->layer = int(x * y);
    look->last_brick = Int4{int32_t(x - 1), int32_t(y - 1), int32_t(z - 1), 0};
    for (size_t i = 0; i < table.shape(0); i++) look->table.push_back(load<float, 4>(table.data() + 4 * i));
    look->last_entry = float(table.shape(0) - 1);
    look->low = low;
    look->scale = scale;
    for (size_t i = 0; i < sums.shape(0); i++)
        look->sums.push_back(Double4{sums(i, 0), sums(i, 1), sums(i, 2), sums(i, 3)});
    look->threshold = threshold;
    look->top = top;
    return look;
}

// Render the rays of `columns` by `rows`, pixels from the centre of the image: light (rows, columns, 4); depth (rows,
// columns, 2) of the first surface and where opacity passes 0.9, or infinity; and work (rows, columns, 2), samples and
// evaluations. `ends` (rows, columns, 4) is the output of `raster`: opaque, behind the part of the volume before it,
// and in front of projections, which have no depth.
void draw(Samples samples, Colours colours, const Look& look, const Mapping* map, Array<const double, -1> columns,
          Array<const double, -1> rows, Array<float, -1, -1, 4> light, Array<double, -1, -1, 2> depth,
          Array<int64_t, -1, -1, 2> work, std::optional<Array<const float, -1, -1, 4>> ends) {
    const int height = (int)rows.size(), width = (int)columns.size();
    const int across = (width + TILE - 1) / TILE, down = (height + TILE - 1) / TILE;
    with_volume(samples, colours, look.labelled, [&](const Volume& voxels) {
        auto draw_tile = [&](int tile, int) {
            const int top = tile / across * TILE, left = tile % across * TILE;
            const int bottom = least(top + TILE, height), right = least(left + TILE, width);
            for (int y = top; y < bottom; y += RAYS / 4)
                for (int x = left; x < right; x += 4) {
                    auto all = [&](auto&& use) {
                        for (int l = 0; l < RAYS; l++)
                            if (x + l % 4 < right && y + l / 4 < bottom) use(l, x + l % 4, y + l / 4);
                    };
                    auto behind = [&](int i, int j) { return ends ? &(*ends)(j, i, 0) : nullptr; };
                    Beam beam;
                    all([&](int l, int i, int j) {
                        beam.enter(look, l, columns(i), rows(j), ends ? behind(i, j)[3] : NEVER);
                    });
                    if (map)
                        beam.march(look, voxels, Inverted(map->strokes, look, beam));
                    else
                        beam.march(look, voxels, Still());
                    all([&](int l, int i, int j) {
                        beam.write(look, l, behind(i, j), &light(j, i, 0), &depth(j, i, 0), &work(j, i, 0));
                    });
                }
        };
        unlocked([&] { parallel(across * down, draw_tile); });
    });
}

// Draw a mesh into the ends of rays, (rows, columns, 4): colours in linear light, and millimetres from the eye,
// initially infinite. Points are in millimetres along the volume's axes, and normals of unit length or 0.
void raster(const Look& look, Triples points, Array<const float, -1, 3> normals, Array<const int32_t, -1, 3> triangles,
            Array<const int32_t, -1, 2> lines, std::array<float, 3> colour, double radius,
            Array<const double, -1> columns, Array<const double, -1> rows, Array<float, -1, -1, 4> out) {
    const Rays rays{columns.data(), rows.data(), (int)columns.size(), (int)rows.size()};
    const Mesh mesh{points.data(),           (int64_t)points.shape(0),    normals.data(),
                    triangles.data(),        (int64_t)triangles.shape(0), lines.data(),
                    (int64_t)lines.shape(0), point_of(colour.data()),     radius};
    unlocked([&] { Raster(look, rays, mesh, out.data()); });
}

// The smallest and the largest sample of each brick.
void brick_ranges(Samples samples, Solid<float> lows, Solid<float> highs) {
    const auto n = sizes(samples), bricks = sizes(lows);
    auto end = [&](int64_t at, int axis) { return least(at * BRICK + BRICK + 1, n[axis]); };
    with_samples(samples, [&]<class T>(const T* data) {
        auto in_layer = [&](int c, int) {
            for (int64_t b = 0, at = c * bricks[0] * bricks[1]; b < bricks[1]; b++)
                for (int64_t a = 0; a < bricks[0]; a++, at++) {
                    T low = std::numeric_limits<T>::max(), high = std::numeric_limits<T>::lowest();
                    for (int64_t z = (int64_t)c * BRICK; z < end(c, 2); z++)
                        for (int64_t y = b * BRICK; y < end(b, 1); y++)
                            for (int64_t x = a * BRICK; x < end(a, 0); x++) {
                                T value = data[(z * n[1] + y) * n[0] + x];
                                low = least(low, value);
                                high = most(high, value);
                            }
                    lows.data()[at] = float(low);
                    highs.data()[at] = float(high);
                }
        };
        unlocked([&] { parallel((int)bricks[2], in_layer); });
    });
}

// The mean of a table's entries for the samples of each block, `wide` voxels wide.
void mean_blocks(Samples samples, std::array<int64_t, 3> wide, Array<const float, -1> table, float low, float scale,
                 Solid<float> out) {
    const auto n = sizes(samples), blocks = sizes(out);
    const float last_entry = float(table.size() - 1), *entries = table.data();
    auto end = [&](int64_t at, int axis) { return least((at + 1) * wide[axis], n[axis]); };
    with_samples(samples, [&](auto* data) {
        auto in_layer = [&](int c, int) {
            for (int64_t b = 0, at = c * blocks[0] * blocks[1]; b < blocks[1]; b++)
                for (int64_t a = 0; a < blocks[0]; a++, at++) {
                    float sum = 0;
                    int count = 0;
                    for (int64_t z = c * wide[2]; z < end(c, 2); z++)
                        for (int64_t y = b * wide[1]; y < end(b, 1); y++)
                            for (int64_t x = a * wide[0]; x < end(a, 0); x++, count++) {
                                float entry = (float(data[(z * n[1] + y) * n[0] + x]) - low) * scale;
                                sum += entries[int32_t(least(most(entry, 0.0f), last_entry) + 0.5f)];
                            }
                    out.data()[at] = sum / float(count);
                }
        };
        unlocked([&] { parallel((int)blocks[2], in_layer); });
    });
}

void brick_distances(Solid<const bool> seen, Solid<uint8_t> out) {
    for (size_t i = 0; i < seen.size(); i++) out.data()[i] = seen.data()[i] ? 0 : 255;
    const int n[3] = {(int)seen.shape(2), (int)seen.shape(1), (int)seen.shape(0)};
    to_distances(n, out.data());
}

}  // namespace

void bind_render(nb::module_& m) {
    m.attr("BRICK") = BRICK;
    nb::class_<Look>(m, "Look",
                     "How a volume is seen: a camera, what its rays may skip, a transfer function, a lamp, a box.")
        .def(nb::new_(&make_look), "camera"_a, "skips"_a, "table"_a, "sums"_a, "low"_a, "scale"_a, "threshold"_a,
             "top"_a, "step"_a, "light"_a, "shaded"_a, "box"_a, "plane"_a, "silhouettes"_a, "projection"_a, "arrives"_a,
             "placed"_a, "labelled"_a);
    m.def("draw", &draw, "samples"_a, "colours"_a.none(), "look"_a, "map"_a.none(), "columns"_a, "rows"_a, "light"_a,
          "depth"_a, "work"_a, "ends"_a = nb::none(),
          "See a volume along the rays of pixels: as it is, or through strokes.");
    m.def("raster", &raster, "look"_a, "points"_a, "normals"_a, "triangles"_a, "lines"_a, "colour"_a, "radius"_a,
          "columns"_a, "rows"_a, "out"_a, "Draw a mesh into what the rays of pixels end at.");
    m.def("brick_ranges", &brick_ranges, "samples"_a, "lows"_a, "highs"_a,
          "Find the smallest and the largest sample of bricks.");
    m.def("block_means", &mean_blocks, "samples"_a, "wide"_a, "table"_a, "low"_a, "scale"_a, "out"_a,
          "Find the mean of a table's entries in blocks of samples.");
    m.def("brick_distances", &brick_distances, "seen"_a, "out"_a, "Find how many bricks away the next seen one is.");
    m.def("look_up", &look_up, "samples"_a, "points"_a, "out"_a, "labelled"_a = false,
          "Sample a volume and its gradient at points.");
}

}  // namespace supple
