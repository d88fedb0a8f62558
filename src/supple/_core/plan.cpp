// Plans: how T⁻¹ on a plane is solved, checked, filled in and bounded.
#include "plan.hpp"

#include "footprint.hpp"
#include "patch.hpp"
#include "table.hpp"
#include "threads.hpp"

namespace supple {

// max(λ₋, λ₊/400) of MMᵀ, for ∂p/∂x = (xx, xy) and ∂p/∂y = (yx, yy).
inline double widest_of(double xx, double xy, double yx, double yy) {
    double a = xx * xx + yx * yx, c = xy * xy + yy * yy, b = xx * xy + yx * yy;
    double h = (a + c) / 2, d = sqrt((a - c) * (a - c) / 4 + b * b);
    return std::max(h - d, (h + d) / 400);
}

// ---- which strokes reach which cells ------------------------------------------------------------------------------

// Bounds of |K_β| and |J_β| in a stroke's own metric, including the slopes of the border's factor and of the mask.
inline Bound bound_within(const Stroke& k, const Axes& axes, int dimensions) {
    Bound bound = bound_of(k);
    for (int i = 0; i < dimensions; i++)
        if (axes[i].sigma > 0 && !k.inner) bound.slope += 2 * bound.value / (axes[i].sigma * (i == 2 ? k.stretch : 1));
    if (k.freeze) {
        const Vicinity near(k);
        bound.slope += bound.value * mask_of(k).bounds_in(near.low, near.high).slope() * std::max(1.0, 1 / k.stretch);
    }
    return bound;
}

template <int D>
Plan<D>::Plan(Strokes given, int width, int height, double z, double tolerance, const Composite* composite,
              const Box* wanted, const Frozen* masks, bool chroma)
    : width(width),
      height(height),
      z(z),
      tolerance(tolerance),
      chroma(chroma),
      map(composite),
      box(wanted ? *wanted : Box{0, width, 0, height}),
      all(std::move(given)),
      size{width, height},
      last{std::max(width - 1, 1), std::max(height - 1, 1)},
      across((last[0] - 1) / ROOT + 1),
      down((last[1] - 1) / ROOT + 1),
      words((strokes.size() + 63) / 64) {
    const int count = (int)strokes.size();
    freeze = nullptr;
    for (const Stroke& k : strokes)
        if (k.freeze) freeze = &mask_of(k);
    while (first_limited < count && !(strokes[first_limited].per_reach > 0)) first_limited++;
    while (first_limited + 1 < count && strokes[first_limited + 1].group == strokes[first_limited].group)
        first_limited++;
    for (const Stroke& k : strokes) bounds.push_back(bound_within(k, axes, D));
    roots.resize((size_t)across * down);
    reaching.assign(roots.size() * words, 0);
    bands.resize((down + BAND - 1) / BAND);
    if (masks && !map) keep_state(masks);
    parallel((int)bands.size(), [this](int i, int) { solve_band(i); });
    for (const Band& b : bands) {
        *this |= b;
        widest = std::max(widest, b.extent.widest);
        identity = identity && b.leaves.empty() && b.pixels.empty();
    }
    if (under) {
        *this |= *under;
        identity = identity && under->identity;
    }
    if (unsolved) error = std::numeric_limits<double>::infinity();
}

// Plan the strokes before the last freeze, for the box that it holds and one more pixel, where chroma may lie.
template <int D>
void Plan<D>::keep_state(const Frozen* masks) {
    for (const auto& [row, mask] : masks->freezes)
        if (row < (int)strokes.size()) hold = mask, held_rows = row;
    if (!hold) return;
    Box inside = box;
    for (int d = 0; d < 2; d++) {
        const double first = floor(hold->low[d] / axes[d].spacing) - 1,
                     last = ceil(hold->high[d] / axes[d].spacing) + 2;
        inside[2 * d] = (int)std::clamp(first, (double)box[2 * d], (double)box[2 * d + 1]);
        inside[2 * d + 1] = (int)std::clamp(last, (double)box[2 * d], (double)box[2 * d + 1]);
    }
    const double at = z * axes[2].spacing;
    const bool outside = D == 3 && (at < hold->low[2] || at > hold->high[2]);
    if (outside || inside[0] >= inside[1] || inside[2] >= inside[3]) {
        hold = nullptr;
        return;
    }
    Strokes before = all;
    before.table.resize(held_rows);
    before.list.resize(held_rows);
    under = std::make_unique<Plan>(std::move(before), width, height, z, tolerance, nullptr, &inside, masks, chroma);
}

// The strokes that reach any of some roots, in order.
template <int D>
template <class RootOf>
Chain Plan<D>::chain_of(Work& w, RootOf root_of) const {
    w.list.clear();
    w.reached.clear();
    for (size_t word = 0; word < words; word++) {
        uint64_t set = 0;
        for (int i = 0; i < LANES; i++) set |= reaching[(size_t)root_of(i) * words + word];
        for (; set; set &= set - 1) {
            const int bit = __builtin_ctzll(set);
            uint8_t lanes = 0;
            for (int i = 0; i < LANES; i++)
                lanes |= (uint8_t)((reaching[(size_t)root_of(i) * words + word] >> bit & 1) << i);
            w.list.push_back((int)(64 * word) + bit);
            w.reached.push_back(lanes);
        }
    }
    return {strokes.data(), w.list.data(), (int)w.list.size(), w.reached.data()};
}

// Map a ball around each root of a row back through the chain: its centre by a fixed-point iteration for each group of
// strokes that it touches, its radius by a bound of the inverse's slope, or of the displacement. It is a ball in the
// metric of the last group, whose third axis is `metric` times as long; while it is flat, in every metric.
template <int D>
void Plan<D>::find_reaching(int j, int left, int right) {
    // Roots are grouped as for the whole row.
    for (int first = left - left % LANES; first < std::min(right + 1, across); first += LANES) {
        Lanes low[D], high[D], centre[D], radius2{};
        for (int l = 0; l < LANES; l++) {
            int i = std::min(first + l, across - 1);
            low[0][l] = column(i) * axes[0].spacing;
            high[0][l] = column(i + 1) * axes[0].spacing;
        }
        low[1] = splat<Lanes>(line(j) * axes[1].spacing);
        high[1] = splat<Lanes>(line(j + 1) * axes[1].spacing);
        if constexpr (D == 3) low[2] = high[2] = splat<Lanes>(z * axes[2].spacing);
        for (int d = 0; d < D; d++) {
            centre[d] = 0.5 * (low[d] + high[d]);
            radius2 += (high[d] - centre[d]) * (high[d] - centre[d]);
        }
        Lanes radius = root(radius2) * (1 + 1e-9);
        Mask rim = radius == radius;
        double metric = std::numeric_limits<double>::infinity();
        const Chain whole = all.chain();
        for (int end = whole.count; end > 0;) {
            const Chain group = whole.last_before(end);
            const int begin = end - group.count;
            end = begin;
            // No displacement exceeds `size`. A single stroke keeps points inside its ball, or outside of it; others of
            // its group move points across, so that balls are extended by `size`.
            double size = 0, bend = 0;
            for (int n = begin; n < begin + group.count; n++) {
                size += bounds[n].value;
                bend += bounds[n].slope;
            }
            const double known = strokes[begin].most, stretch = strokes[begin].stretch;
            size = std::min(size, known);
            const Lanes own = stretch > metric ? Lanes(radius * (stretch / metric)) : radius;  // in the group's metric
            const auto from_pivot = [&](const Stroke& k, const Lanes* x, int d) {
                return d < 2 ? Lanes(x[d] - k.pivot[d]) : Lanes((x[d] - k.pivot[d]) * stretch);
            };
            Mask touched = radius != radius;
            const auto away = [&](const Stroke& k) {
                Lanes distance2{};
                for (int d = 0; d < D; d++) {
                    const Lanes r = from_pivot(k, centre, d);
                    distance2 += r * r;
                }
                return root(distance2);
            };
            for (int n = begin; n < begin + group.count; n++) {
                const Stroke& k = strokes[n];
                Lanes far2{};
                for (int d = 0; d < D; d++) {
                    Lanes corner = most(magnitude(from_pivot(k, low, d)), magnitude(from_pivot(k, high, d)));
                    far2 += corner * corner;
                }
                Mask by = without(Mask{} == 0, away(k) >= k.reach + own);  // also for NaN
                rim = without(rim, both(by, far2 < k.reach * k.reach));
                touched = either(touched, by);
            }
            for (int n = begin; n < begin + group.count; n++) {
                const Stroke& k = strokes[n];
                const double reach = k.reach + (group.count > 1 ? size : 0);
                Mask by = without(touched, away(k) >= reach + own);
                for (int l = 0; l < LANES && first + l < across; l++)
                    if (by[l]) reaching[((size_t)j * across + first + l) * words + n / 64] |= 1ull << (n % 64);
            }
            if (begin <= first_limited || !any(touched)) continue;
            Lanes x[D], off2{};
            for (int d = 0; d < D; d++) x[d] = centre[d];
            turn_back<D>(group, axes.data(), x);
            for (int round = 0; round < 3; round++) {
                Lanes y[D];
                for (int d = 0; d < D; d++) y[d] = x[d];
                apply<D>(group, axes.data(), y);
                off2 = Lanes{};
                for (int d = 0; d < D; d++) {
                    Lanes e = centre[d] - y[d], there = d < 2 ? e : Lanes(e * stretch);
                    off2 += there * there;
                    if (round < 2) x[d] += e;
                }
            }
            // Within the ball's preimage, displacements are bounded by the sizes at its point nearest to a pivot.
            Lanes zero{}, one = splat<Lanes>(1.0), off = root(off2), moved{};
            for (int n = begin; n < begin + group.count; n++) {
                Lanes near = most(Lanes(away(strokes[n]) - most(own, off) - size), zero);
                if (strokes[n].flat > 0) near = eased(strokes[n], near);
                Lanes t = least(Lanes(near * strokes[n].per_reach), one), v = one - t;
                Lanes faded = bounds[n].unlimited * v * v * v * (1.0 + t * (3.0 + 6.0 * t));
                moved += least(faded, splat<Lanes>(bounds[n].value));
            }
            Lanes grown = own + off + 2.0 * least(moved, splat<Lanes>(known));
            if (bend < 0.9) grown = least(grown, Lanes((own + off) * (1 / (1 - bend))));
            // A twist is a rotation of a shear.
            if (is_whole(strokes[begin]) && group.count == 1) grown = least(grown, Lanes((own + off) * (1 + bend)));
            radius = choose(touched, grown, own);
            metric = stretch;
            for (int d = 0; d < D; d++) centre[d] = choose(touched, x[d], centre[d]);
        }
        for (int l = 0; l < LANES && first + l < across; l++) {
            const int index = j * across + first + l;
            roots[index].rim = rim[l];
            if (freeze || hold) thaw(index);
        }
    }
}

// Clear the strokes of a root that is frozen for each of them: there, the map is the identity, as outside of every
// ball. A root with only some frozen samples becomes a rim, and one that a freeze holds keeps the map of the strokes
// before.
template <int D>
void Plan<D>::thaw(int index) {
    const int i = index % across, j = index / across;
    const double low[3] = {column(i) * axes[0].spacing, line(j) * axes[1].spacing, z * axes[2].spacing};
    const double high[3] = {column(i + 1) * axes[0].spacing, line(j + 1) * axes[1].spacing, low[2]};
    const Frozen* last = nullptr;  // neighbours often share a mask
    bool frozen = true, still = false, some = hold && !hold->is_free(low, high);
    if (hold && hold->is_frozen(low, high)) {
        roots[index].held = true;
        for (int n = held_rows; n < (int)strokes.size(); n++)
            reaching[(size_t)index * words + n / 64] &= ~(1ull << (n % 64));
        return;
    }
    for (size_t word = 0; word < words; word++)
        for (uint64_t set = reaching[(size_t)index * words + word]; set; set &= set - 1) {
            const Stroke& k = strokes[64 * word + __builtin_ctzll(set)];
            if (!k.freeze) {
                double near2 = 0;
                for (int d = 0; d < D; d++) {
                    const double near = std::max({low[d] - k.pivot[d], k.pivot[d] - high[d], 0.0});
                    near2 += near * near;
                }
                frozen = frozen && near2 >= k.reach * k.reach;
                continue;
            }
            if (last != k.freeze) {
                last = &mask_of(k);
                still = last->is_frozen(low, high);
                some = some || !last->is_free(low, high);
            }
            frozen = frozen && still;
        }
    if (frozen)
        std::fill_n(reaching.data() + (size_t)index * words, words, 0);
    else if (some)
        roots[index].rim = true;
}

// ---- nodes ----------------------------------------------------------------------------------------------------------

// Solve the nodes in `asks`, and store the solutions.
template <int D>
void Plan<D>::solve(Work& w, Guess guess) {
    int count = (int)w.asks.size();
    for (int start = 0; start < count; start += LANES) {
        auto ask = [&](int i) -> Ask& { return w.asks[std::min(start + i, count - 1)]; };
        Lanes q[D];
        Solution<D, Lanes> found{};
        for (int i = 0; i < LANES; i++) {
            const Ask& a = ask(i);
            for (int d = 0; d < D; d++) {
                q[d][i] = (d < 2 ? a.q[d] : z) * axes[d].spacing;
                found.p[d][i] = guess == Guess::NONE ? q[d][i] : a.p[d] * axes[d].spacing;
                for (int e = 0; e < D; e++) found.m[e][d][i] = a.m[e][d] * axes[d].spacing / axes[e].spacing;
            }
        }
        Solved<D, Lanes> known{};
        Passed<Lanes> passed;
        if (map)
            passed = solve_composite<D, true>(*map, q, known);
        else {
            const Chain chain = chain_of(w, [&](int i) { return ask(i).root; });
            known =
                solved<D>(chain, axes.data(), q, finest_of<D>(axes.data()), tolerance, guess, found, freeze != nullptr);
            passed.within = Mask{} == 0;
            passed.upright = determinant_of(known.at.m) > 0.0;  // composites may mirror, and report folds themselves
        }
        for (int i = 0; i < LANES && start + i < count; i++) {
            Node<D>& node = w.nodes[ask(i).node];
            for (int d = 0; d < D; d++) {
                node.p[d] = known.at.p[d][i] / axes[d].spacing;
                node.mixed[d] = known.mixed[d][i] * axes[0].spacing * axes[1].spacing / axes[d].spacing;
                for (int e = 0; e < D; e++) node.m[e][d] = known.at.m[e][d][i] * axes[e].spacing / axes[d].spacing;
            }
            for (int j = 0; j < 2; j++) node.smooth[j] = sqrt(known.smooth2[j][i]) / axes[j].spacing;
            w.band->evaluations += known.at.steps[i];
            w.band->unsolved += !known.at.done[i];
            w.band->outside += !passed.within[i];
            w.band->folds += !passed.upright[i];
        }
    }
    w.asks.clear();
}

// ---- cells ----------------------------------------------------------------------------------------------------------

template <int D>
void Plan<D>::emit(Work& w, int root, int x, int y, int wide, int high, const double (*c)[16], const float* depth) {
    Leaf<D> leaf{};
    leaf.x = x;
    leaf.y = y;
    leaf.w = wide;
    leaf.h = high;
    std::copy(depth, depth + 4, leaf.depth);
    // In a cell one pixel wide, only chroma lies beyond its first side.
    const double far_x = wide > 1 || chroma ? wide - (x + wide == size[0]) : 0;
    const double far_y = high > 1 || chroma ? high - (y + high == size[1]) : 0;
    w.band->error = std::max(w.band->error, round_patch<D>(c, far_x, far_y, leaf));
    Root& r = roots[root];
    w.band->leaves.push_back(leaf);
    w.band->next.push_back(r.first);
    r.first = (int)w.band->leaves.size() - 1;
    r.leaves++;
}

template <int D>
void Plan<D>::solve_band(int index) {
    int first = index * BAND, end = std::min(first + BAND, down);
    if (line(first) >= box[3] || past(1, line(end)) <= box[2]) return;
    Work w;
    w.band = &bands[index];
    // The columns and rows of roots that the box meets.
    int left = 0, right = across, top = first, bottom = end;
    while (left < across - 1 && past(0, column(left + 1)) <= box[0]) left++;
    while (right > left + 1 && column(right - 1) >= box[1]) right--;
    while (top < end - 1 && past(1, line(top + 1)) <= box[2]) top++;
    while (bottom > top + 1 && line(bottom - 1) >= box[3]) bottom--;
    for (int j = first; j < end; j++) {
        if (!map && j <= bottom) find_reaching(j, left, right);
        for (int i = 0; i < across; i++) roots[j * across + i].band = index;
    }
    if (map && !map->smooth) {
        w.band->anchors.resize((size_t)(end - first) * across);
        w.band->extents.resize(w.band->anchors.size());
        for (int root = first * across; root < end * across; root++) solve_pixels(root);
        return;
    }
    w.nodes.resize((size_t)(end - first + 1) * (across + 1));
    // Each row with guesses from the one above.
    for (int j = first; j <= bottom; j++) {
        for (int i = left; i <= right; i++) {
            Ask a{};
            a.q[0] = column(i);
            a.q[1] = line(j);
            a.node = (j - first) * (across + 1) + i;
            a.root = std::min(j, end - 1) * across + std::min(i, across - 1);
            if (j > first) {
                const Node<D>& above = w.nodes[a.node - across - 1];
                double h = line(j) - line(j - 1);
                for (int d = 0; d < D; d++) a.p[d] = above.p[d] + h * above.m[1][d];
                if (j > first + 1) {
                    const Node<D>& before = w.nodes[a.node - 2 * (across + 1)];
                    for (int d = 0; d < D; d++) a.p[d] += 0.5 * h * (above.m[1][d] - before.m[1][d]);
                }
            }
            w.asks.push_back(a);
        }
        solve(w, j > first ? Guess::POINT : Guess::NONE);
    }
    for (int j = top; j < bottom; j++)
        for (int i = left; i < right; i++) {
            int root = j * across + i, node = (j - first) * (across + 1) + i;
            const uint64_t* set = reaching.data() + (size_t)root * words;
            if (!map && (roots[root].held || std::all_of(set, set + words, [](uint64_t s) { return s == 0; })))
                continue;
            w.cells.push_back({root,
                               column(i),
                               line(j),
                               column(i + 1),
                               line(j + 1),
                               {node, node + 1, node + across + 1, node + across + 2}});
        }
    while (!w.cells.empty()) {
        check(w);
        w.cells.swap(w.split);
        w.split.clear();
    }
    for (int j = top; j < bottom; j++)
        for (int i = left; i < right; i++) {
            const Extent<D> e = extent(j * across + i);
            roots[j * across + i].largest = (float)e.largest;
            w.band->extent |= e;
        }
}

// Solve every pixel of a root within the box's columns.
template <int D>
void Plan<D>::solve_pixels(int index) {
    const int i = index % across, j = index / across;
    const int left = column(i), top = line(j), right = past(0, column(i + 1)), bottom = past(1, line(j + 1));
    if (right <= box[0] || left >= box[1] || bottom <= box[2] || top >= box[3]) return;
    Root& root = roots[index];
    Band& band = bands[root.band];
    const int own = (j % BAND) * across + i;
    Extent<D>& extent = band.extents[own];
    std::array<int, D>& anchor = band.anchors[own];
    root.first_pixel = (ptrdiff_t)band.pixels.size();
    band.pixels.resize(band.pixels.size() + (size_t)(right - left) * (bottom - top));
    Pixel* first = band.pixels.data() + root.first_pixel;
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x += LANES) {
            const int n = std::min(LANES, right - x);
            Pixel* to = first + (ptrdiff_t)(y - top) * (right - left) + (x - left);
            Lanes q[D];
            for (int l = 0; l < LANES; l++) q[0][l] = (x + std::min(l, n - 1)) * axes[0].spacing;
            q[1] = splat<Lanes>(y * axes[1].spacing);
            if constexpr (D == 3) q[2] = splat<Lanes>(z * axes[2].spacing);
            auto jet = jet_at<D, D>(q);
            Passed<Lanes> passed = pass<D>(*map, true, jet);
            for (int d = 0; d < D; d++) {
                jet.x[d] /= axes[d].spacing;
                for (int e = 0; e < D; e++) jet.t[e][d] *= axes[e].spacing / axes[d].spacing;
            }
            for (int d = 0; d < D; d++) {  // limit unsolved points: they must not require all frames up to them
                const Lanes at = q[d] / axes[d].spacing;
                jet.x[d] = choose(passed.done, jet.x[d], most(least(jet.x[d], at + FAR), at - FAR));
            }
            if (x == left && y == top)
                for (int d = 0; d < D; d++) anchor[d] = (int)std::clamp(floor(jet.x[d][0]), -1e9, 1e9);
            for (int l = 0; l < n; l++) {
                Pixel& pixel = to[l];
                double moved = 0, spread = 0, rate = 0;
                for (int d = 0; d < D; d++) {
                    const double p = std::clamp(jet.x[d][l], -1e9, 1e9), off = p - anchor[d];
                    pixel.part[d] = (float)off;
                    band.error = std::max(band.error, fabs(pixel.part[d] - off));
                    extent.low[d] = std::min(extent.low[d], p);
                    extent.high[d] = std::max(extent.high[d], p);
                    moved = std::max(moved, fabs(p - (d == 0 ? x + l : d == 1 ? y : z)));
                    (d < 2 ? spread : rate) += jet.t[0][d][l] * jet.t[0][d][l] + jet.t[1][d][l] * jet.t[1][d][l];
                }
                for (int d = 0; d < 2; d++) {
                    pixel.across[d] = (float)jet.t[0][d][l];
                    pixel.down[d] = (float)jet.t[1][d][l];
                }
                if constexpr (D == 3) rate += jet.t[2][2][l] * jet.t[2][2][l];
                pixel.depth2 = (float)rate;
                extent.moved = std::max(extent.moved, moved);
                extent.spread = std::max(extent.spread, spread);
                extent.largest = std::max(extent.largest, spread);
                extent.rate = std::max(extent.rate, sqrt(rate));
                extent.widest =
                    std::max(extent.widest, widest_of(jet.t[0][0][l], jet.t[0][1][l], jet.t[1][0][l], jet.t[1][1][l]));
                band.evaluations += passed.steps[l];
                band.unsolved += !passed.done[l];
                band.folds += !passed.upright[l];
                band.outside += !passed.within[l];
            }
        }
    root.largest = (float)extent.largest;
    band.extent |= extent;
}

// Keep the good cells, split the others.
template <int D>
void Plan<D>::check(Work& w) {
    const double allowed = pow(std::min(tolerance, COARSEST) / reserve(), 2);
    int count = (int)w.cells.size();
    for (int start = 0; start < count; start += LANES) {
        auto cell = [&](int i) -> const Cell& { return w.cells[std::min(start + i, count - 1)]; };
        Chain chain{};
        if (!map) chain = chain_of(w, [&](int i) { return cell(i).root; });
        // For each corner: p, ∂p/∂x, ∂p/∂y, the twist; and the mean of ∂p/∂z.
        Lanes x0, y0, h, k, value[D][4], slope[2][D][4], twist[D][4], across_plane[D] = {};
        Lanes smooth[2] = {splat<Lanes>(1e300), splat<Lanes>(1e300)}, c[D][16], worst{};
        for (int i = 0; i < LANES; i++) {
            const Cell& e = cell(i);
            x0[i] = e.x0;
            y0[i] = e.y0;
            h[i] = e.x1 - e.x0;
            k[i] = e.y1 - e.y0;
            for (int v = 0; v < 4; v++) {
                const Node<D>& node = w.nodes[e.corner[v]];
                for (int d = 0; d < D; d++) {
                    value[d][v][i] = node.p[d];
                    slope[0][d][v][i] = node.m[0][d];
                    slope[1][d][v][i] = node.m[1][d];
                    twist[d][v][i] = node.mixed[d];
                    if constexpr (D == 3) across_plane[d][i] += 0.25 * node.m[2][d];
                }
                for (int j = 0; j < 2; j++) smooth[j][i] = std::min(smooth[j][i], node.smooth[j]);
            }
        }
        Lanes per_h = 1.0 / h, per_k = 1.0 / k;
        for (int d = 0; d < D; d++) patch_of(value[d], slope[0][d], slope[1][d], twist[d], per_h, per_k, c[d]);
        // In a cell one pixel wide or high, all samples are on the sides.
        Lanes step[5][D], side[2] = {};
        Mask thin[2] = {h <= 1.0, k <= 1.0}, single = both(thin[0], thin[1]);
        Mask coarse[2] = {without(h > RESOLVED * smooth[0], thin[0]), without(k > RESOLVED * smooth[1], thin[1])};
        for (int n = 0; n < SEEN; n++) {
            if (!any(without(Mask{} == 0, single))) break;  // single pixels are exact
            if (n == 5 && !any(without(worst <= allowed, either(coarse[0], coarse[1])))) break;  // all are split

            Lanes q[D], g[D], off, steps{};
            const Lanes s = choose(thin[0], splat<Lanes>(SEEN_X[n] > 0.5), SEEN_X[n] * h);
            const Lanes t = choose(thin[1], splat<Lanes>(SEEN_Y[n] > 0.5), SEEN_Y[n] * k);
            q[0] = x0 + s;
            q[1] = y0 + t;
            if constexpr (D == 3) q[2] = splat<Lanes>(z);
            if (map) {
                off = off_composite<D>(*map, axes.data(), c, s, t, q, g, steps);
                for (int i = 0; i < LANES && start + i < count; i++) w.band->evaluations += steps[i];
            } else if (n > 0)
                off = off_chain<D, 0>(chain, axes.data(), c, s, t, q, across_plane, g);
            else
                off = off_chain<D, D>(chain, axes.data(), c, s, t, q, across_plane, g);
            for (int d = 0; n < 5 && d < D; d++) step[n][d] = g[d];
            off = choose(off == off, off, splat<Lanes>(1e300));
            worst = most(worst, off);
            // The error along an edge depends only on the length of that edge.
            if (n > 0 && n < 5) side[n > 2] = most(side[n > 2], off);
        }
        for (int i = 0; i < LANES && start + i < count; i++) {
            const Cell e = cell(i);
            if (!single[i] && (!(worst[i] <= allowed) || coarse[0][i] || coarse[1][i])) {
                Checked found;
                for (int d = 0; d < D; d++) {
                    for (int n = 0; n < 16; n++) found.c[d][n] = c[d][n][i];
                    for (int n = 0; n < 5; n++) found.step[n][d] = step[n][d][i];
                    found.across_plane[d] = across_plane[d][i];
                }
                // A side with a small error is not split.
                found.too_wide = coarse[0][i] || !(4 * side[0][i] <= allowed);
                found.too_high = coarse[1][i] || !(4 * side[1][i] <= allowed);
                split(w, e, found);
                continue;
            }
            double own[D][16];
            for (int d = 0; d < D; d++)
                for (int n = 0; n < 16; n++) own[d][n] = c[d][n][i];
            float depth[4] = {1, 0, 0, 0};
            if constexpr (D == 3) {
                double v[4];
                for (int n = 0; n < 4; n++) v[n] = w.nodes[e.corner[n]].m[2][2];
                bilinear_of(v, e.x1 - e.x0, e.y1 - e.y0, depth);
            }
            emit(w, e.root, e.x0, e.y0, past(0, e.x1) - e.x0, past(1, e.y1) - e.y0, own, depth);
            if (!single[i]) w.band->error = std::max(w.band->error, reserve() * sqrt(worst[i]));
        }
    }
    solve(w, Guess::PATCH);
}

// Split a cell along each side that is too long, in halves or into single pixels; its patch, corrected by its error,
// gives guesses of the new nodes.
template <int D>
void Plan<D>::split(Work& w, const Cell& e, const Checked& found) {
    const int wide = e.x1 - e.x0, high = e.y1 - e.y0;
    // A good side is not split, unless both are.
    const bool across = wide > 1 && (found.too_wide || !(found.too_high && high > 1));
    const bool down = high > 1 && (found.too_high || !(found.too_wide && wide > 1));
    int xs[SMALL + 1], ys[SMALL + 1], node[SMALL + 1][SMALL + 1];
    auto cuts = [&](int from, int to, bool cut, int* at) {
        int n = !cut ? 1 : to - from <= (freeze ? BESIDE_FROZEN : SMALL) ? to - from : 2;
        for (int i = 0; i <= n; i++) at[i] = from + (to - from) * i / n;
        return n;
    };
    const int nx = cuts(e.x0, e.x1, across, xs), ny = cuts(e.y0, e.y1, down, ys);
    for (int v = 0; v <= ny; v++)
        for (int u = 0; u <= nx; u++) {
            if ((u == 0 || u == nx) && (v == 0 || v == ny)) {
                node[v][u] = e.corner[(u ? 1 : 0) + (v ? 2 : 0)];
                continue;
            }
            Ask a{};
            a.q[0] = xs[u];
            a.q[1] = ys[v];
            a.root = e.root;
            a.node = node[v][u] = (int)w.nodes.size();
            w.nodes.emplace_back();
            // The nearest checked point.
            int near = v == 0 ? 1 : v == ny ? 2 : u == 0 ? 3 : u == nx ? 4 : 0;
            for (int d = 0; d < D; d++) {
                a.p[d] = at(found.c[d], double(xs[u] - e.x0), double(ys[v] - e.y0), a.m[0][d], a.m[1][d]) -
                         found.step[near][d];
                if (D == 3) a.m[D - 1][d] = found.across_plane[d];
            }
            w.asks.push_back(a);
        }
    for (int v = 0; v < ny; v++)
        for (int u = 0; u < nx; u++)
            w.split.push_back({e.root,
                               xs[u],
                               ys[v],
                               xs[u + 1],
                               ys[v + 1],
                               {node[v][u], node[v][u + 1], node[v + 1][u], node[v + 1][u + 1]}});
}

// ---- filling --------------------------------------------------------------------------------------------------------

// The position of the upper face, in pixels; samples on it are not displaced across it.
inline double face_of(const Axis& a) { return a.last / a.spacing; }
constexpr double ON_FACE = 1e-6;

// The samples `from` to `to` - 1 of the grid's row y, all within a leaf; `left` is the first of the row's.
template <int D>
void Plan<D>::fill(const Leaf<D>& leaf, const Grid& grid, int y, int from, int to, int left,
                   Row<D>& __restrict row) const {
    // On a fixed face and beyond it, where chroma of the last pixel may lie, the map along the face is that on the
    // face: the patch of the last cell is extended from the last pixel's centre to the face.
    const double below = y * grid.step[1] + grid.offset[1];
    const bool on_face = axes[1].fixed() && below > face_of(axes[1]) - ON_FACE;
    const float t = (float)((on_face ? face_of(axes[1]) : below) - leaf.y);
    const float start = (float)(from * grid.step[0] + grid.offset[0] - leaf.x), stride = (float)grid.step[0];
    const int n = to - from, at = from - left;
    float s[STRIDE];
    for (int i = 0; i < n; i++) s[i] = start + stride * (float)i;
    int inner = n;  // samples before the face
    const double face = face_of(axes[0]) - ON_FACE;
    if (axes[0].fixed() && (to - 1) * grid.step[0] + grid.offset[0] > face) {
        inner = std::clamp((int)floor((face - grid.offset[0]) / grid.step[0]) + 1 - from, 0, n);
        for (int i = inner; i < n; i++) s[i] = (float)(face_of(axes[0]) - leaf.x);
    }
    float along[D][4], rise[D][4];
    for (int d = 0; d < D; d++)
        for (int i = 0; i < 4; i++) {
            const float* b = leaf.c[d] + i;
            along[d][i] = b[0] + t * (b[4] + t * (b[8] + t * b[12]));
            rise[d][i] = b[4] + t * (2 * b[8] + 3 * t * b[12]);
        }
    for (int d = 0; d < D; d++) {
        // In samples of the grid: (p - offset) / step.
        int anchor = leaf.anchor[d];
        float scale = 1, shift = 0;
        if (d < 2 && (grid.step[d] > 1 || grid.offset[d] != 0)) {
            double base = (leaf.anchor[d] - grid.offset[d]) / grid.step[d];
            anchor = (int)floor(base);
            scale = 1.0f / grid.step[d];
            shift = (float)(base - anchor);
        }
        const float* a = along[d];
        for (int i = 0; i < n; i++) {
            const float x = (a[0] + s[i] * (a[1] + s[i] * (a[2] + s[i] * a[3]))) * scale + shift;
            const float whole = floored(x);
            row.whole[d][at + i] = (int)whole + anchor;
            row.part[d][at + i] = x - whole;
        }
    }
    for (int i = inner; i < n; i++) {  // no displacement across a face
        row.whole[0][at + i] = from + i;
        row.part[0][at + i] = 0;
    }
    for (int i = 0; on_face && i < n; i++) {
        row.whole[1][at + i] = y;
        row.part[1][at + i] = 0;
    }
    if (!row.sloped) return;
    for (int d = 0; d < 2; d++) {
        const float *a = along[d], *b = rise[d], to_down = (float)grid.step[1] / grid.step[d],
                    to_across = stride / grid.step[d];
        for (int i = 0; i < n; i++) {
            row.across[d][at + i] = (a[1] + s[i] * (2 * a[2] + 3 * s[i] * a[3])) * to_across;
            row.down[d][at + i] = (b[0] + s[i] * (b[1] + s[i] * (b[2] + s[i] * b[3]))) * to_down;
        }
    }
    if (D == 3 && row.averaged) {
        const float *a = along[D - 1], *b = rise[D - 1], *r = leaf.depth, down = (float)grid.step[1];
        for (int i = 0; i < n; i++) {
            float across = (a[1] + s[i] * (2 * a[2] + 3 * s[i] * a[3])) * stride;
            float dt = (b[0] + s[i] * (b[1] + s[i] * (b[2] + s[i] * b[3]))) * down;
            float own = r[0] + s[i] * r[1] + t * (r[2] + s[i] * r[3]);
            row.depth2[at + i] = across * across + dt * dt + own * own;
        }
    }
}

// Fill a row of a root in which every pixel is solved.
template <int D>
void Plan<D>::fill_pixels(const Root& root, int index, int y, int n, Row<D>& row) const {
    const Band& band = bands[root.band];
    const int j = index / across;
    const std::array<int, D>& anchor = band.anchors[(size_t)(j % BAND) * across + index % across];
    const Pixel* from = band.pixels.data() + root.first_pixel + (ptrdiff_t)(y - line(j)) * n;
    for (int i = 0; i < n; i++) {
        for (int d = 0; d < D; d++) {
            const float whole = floorf(from[i].part[d]);
            row.whole[d][i] = (int)whole + anchor[d];
            row.part[d][i] = from[i].part[d] - whole;
        }
        for (int d = 0; d < 2; d++) {
            row.across[d][i] = from[i].across[d];
            row.down[d][i] = from[i].down[d];
        }
        row.depth2[i] = from[i].depth2;
    }
}

// Find the samples that lie outside the ball of every stroke, or are frozen. True if these are all of the row.
template <int D>
bool Plan<D>::mark(int index, const Grid& grid, int x, int y, int n, Row<D>& row) const {
    std::fill(row.same, row.same + n, true);
    const Freeze* last = nullptr;  // neighbours often share a mask
    bool frozen[STRIDE];
    double py = (y * grid.step[1] + grid.offset[1]) * axes[1].spacing, sx = axes[0].spacing;
    for (size_t word = 0; word < words; word++)
        for (uint64_t set = reaching[(size_t)index * words + word]; set; set &= set - 1) {
            const Stroke& k = strokes[64 * word + __builtin_ctzll(set)];
            double chord = k.reach * k.reach - (py - k.pivot[1]) * (py - k.pivot[1]);
            const double deep = (z * axes[2].spacing - k.pivot[2]) * k.stretch;
            if (D == 3) chord -= deep * deep;
            if (chord < 0) continue;
            chord = sqrt(chord);
            // In samples from x on; excludes the ball's boundary, where there is no displacement, with a tolerance.
            double first = ((k.pivot[0] - chord) / sx - grid.offset[0]) / grid.step[0] - x;
            double final = ((k.pivot[0] + chord) / sx - grid.offset[0]) / grid.step[0] - x;
            int from = (int)std::clamp(floor(first + 1e-9) + 1, 0.0, (double)n);
            int to = (int)std::clamp(ceil(final - 1e-9), 0.0, (double)n);
            if (k.freeze && k.freeze != last) {
                last = k.freeze;
                for (int i = 0; i < n; i++) {
                    const double at[3] = {((x + i) * grid.step[0] + grid.offset[0]) * sx, py, z * axes[2].spacing};
                    frozen[i] = is_frozen<3>(*last, at);
                }
            }
            for (int i = from; i < to; i++) row.same[i] = row.same[i] && k.freeze && frozen[i];
        }
    const auto count = std::count(row.same, row.same + n, true);
    row.some_same = count > 0;
    return count == n;
}

// Set sample i of a row that begins with x to the identity.
template <int D>
void Plan<D>::same(Row<D>& row, int i, int x, int y) const {
    row.same[i] = row.some_same = true;
    row.whole[0][i] = x + i;
    row.whole[1][i] = y;
    row.part[0][i] = row.part[1][i] = 0;
    row.across[0][i] = row.down[1][i] = row.depth2[i] = 1;
    row.across[1][i] = row.down[0][i] = 0;
    if constexpr (D == 3) {
        row.whole[2][i] = (int)z;
        row.part[2][i] = 0;
    }
}

// Set the samples that a freeze holds to the map of the strokes before it.
template <int D>
void Plan<D>::restore(int index, const Grid& grid, int x, int y, int n, Row<D>& row) const {
    bool frozen[STRIDE], some = false;
    for (int i = 0; i < n; i++) {
        const double at[3] = {((x + i) * grid.step[0] + grid.offset[0]) * axes[0].spacing,
                              (y * grid.step[1] + grid.offset[1]) * axes[1].spacing, z * axes[2].spacing};
        frozen[i] = is_frozen<3>(*hold, at);
        some = some || frozen[i];
    }
    if (!some) return;
    Row<D> state;
    const bool moved = under->fill_root(grid, index, x, x + n, y, row.sloped ? Slopes::ALL : Slopes::NONE, state);
    for (int i = 0; i < n; i++) {
        if (!frozen[i]) continue;
        if (!moved || (state.some_same && state.same[i])) {
            same(row, i, x, y);
            continue;
        }
        row.same[i] = false;
        for (int d = 0; d < D; d++) {
            row.whole[d][i] = state.whole[d][i];
            row.part[d][i] = state.part[d][i];
        }
        if (!row.sloped) continue;
        for (int d = 0; d < 2; d++) {
            row.across[d][i] = state.across[d][i];
            row.down[d][i] = state.down[d][i];
        }
        row.depth2[i] = state.depth2[i];
    }
}

// Whether a footprint of a root may be larger than a sample, with a reserve for rounding. For a composite, bounds hold
// only at pixels.
inline bool may_shrink(const Grid& grid, float largest, bool composite) {
    return grid.step[0] != grid.step[1] || (composite && grid.step[0] > 1) || largest > 1 + LOW - 1e-3;
}

// Fill the samples of a root in a row; false if all are the identity, and nothing is set.
template <int D>
bool Plan<D>::fill_root(const Grid& grid, int index, int left, int right, int y, Slopes slopes, Row<D>& row) const {
    const Root& root = roots[index];
    if (root.held) return under->fill_root(grid, index, left, right, y, slopes, row);
    const Band& band = bands[root.band];
    const double at = y * grid.step[1] + grid.offset[1];
    row.some_same = false;
    row.idle = is_still(index) || (root.rim && mark(index, grid, left, y, right - left, row) && !under);
    if (row.idle) return false;
    row.averaged = slopes == Slopes::ALL;
    row.sloped = row.averaged || (slopes == Slopes::SHRINKING && may_shrink(grid, root.largest, map != nullptr));
    if (root.first_pixel >= 0) fill_pixels(root, index, y, right - left, row);
    for (int l = root.first; l >= 0; l = band.next[l]) {
        const Leaf<D>& leaf = band.leaves[l];
        bool lowest = leaf.y + leaf.h >= size[1], rightmost = leaf.x + leaf.w >= size[0];
        if (at < leaf.y ? leaf.y > 0 : !lowest && at >= leaf.y + leaf.h) continue;
        const int from = leaf.x % ROOT == 0 ? left : grid.from(0, leaf.x);
        const int to = rightmost || (leaf.x + leaf.w) % ROOT == 0 ? right : grid.from(0, leaf.x + leaf.w);
        if (from < to) fill(leaf, grid, y, from, to, left, row);
    }
    row.count = right - left;
    for (int i = 0; row.some_same && i < row.count; i++)
        if (row.same[i]) same(row, i, left, y);
    if (under && root.rim) restore(index, grid, left, y, right - left, row);
    return true;
}

template <int D>
void Plan<D>::each_row(const Grid& grid, int root_row, const int (&box)[4], Slopes slopes, const Use& use) const {
    Row<D> row{};  // vectors of eight read past a row's end
    int top, bottom;
    part_of(grid, 1, root_row, top, bottom);
    std::vector<int> starts(across + 1);  // of the roots' samples, which never decrease
    for (int i = 0; i < across; i++) part_of(grid, 0, i, starts[i], starts[i + 1]);
    int begin = 0, end = across;
    while (begin < end && starts[begin + 1] <= box[0]) begin++;
    while (begin < end && starts[end - 1] >= box[1]) end--;
    // Whole rows, so that frames are read, and results written, in order.
    for (int y = std::max(top, box[2]); y < std::min(bottom, box[3]); y++)
        for (int i = begin; i < end; i++) {
            const int left = starts[i], a = std::max(left, box[0]), b = std::min(starts[i + 1], box[1]);
            if (a >= b) continue;
            const bool moved = fill_root(grid, root_row * across + i, left, starts[i + 1], y, slopes, row);
            use(row, a, y, b - a, moved ? a - left : 0);
        }
}

// ---- bounds of the whole --------------------------------------------------------------------------------------------

template <int D>
void Plan<D>::widen(const Leaf<D>& leaf, Extent<D>& e) const {
    // A patch is in the hull of its Bézier points, and its slopes in that of their differences. Samples lie up to the
    // next leaf, the last pixel, or a fixed face; for a composite, only at pixels, as its slopes at folds may lead
    // anywhere.
    auto reached = [this](int axis, double from, double to) {
        if (map) return std::max(to - from - 1, 1e-3);
        if (to >= size[axis]) to = axes[axis].fixed() ? face_of(axes[axis]) : size[axis] - 1.0;
        return std::max(to - from, 1e-3);
    };
    const double side[2] = {reached(0, leaf.x, leaf.x + leaf.w), reached(1, leaf.y, leaf.y + leaf.h)};
    auto controls = [](double* c, int step, double h) {
        double c0 = c[0], c1 = c[step] * h, c2 = c[2 * step] * h * h, c3 = c[3 * step] * h * h * h;
        c[step] = c0 + c1 / 3;
        c[2 * step] = c0 + 2 * c1 / 3 + c2 / 3;
        c[3 * step] = c0 + c1 + c2 + c3;
    };
    double spread[2] = {0, 0}, rate = 0, slopes[D][2] = {};
    for (int d = 0; d < D; d++) {
        double b[16], (&slope)[2] = slopes[d];
        for (int i = 0; i < 16; i++) b[i] = leaf.c[d][i];
        for (int j = 0; j < 4; j++) controls(b + 4 * j, 1, side[0]);
        for (int i = 0; i < 4; i++) controls(b + i, 4, side[1]);
        for (int j = 0; j < 4; j++)
            for (int i = 0; i < 4; i++) {
                double p = b[4 * j + i] + leaf.anchor[d];
                double q = d == 0 ? leaf.x + side[0] * i / 3 : d == 1 ? leaf.y + side[1] * j / 3 : z;
                e.low[d] = std::min(e.low[d], p);
                e.high[d] = std::max(e.high[d], p);
                e.moved = std::max(e.moved, fabs(p - q));
                if (i < 3) slope[0] = std::max(slope[0], fabs(b[4 * j + i + 1] - b[4 * j + i]) * 3 / side[0]);
                if (j < 3) slope[1] = std::max(slope[1], fabs(b[4 * j + i + 4] - b[4 * j + i]) * 3 / side[1]);
            }
        for (int j = 0; j < 2; j++) (d < 2 ? spread[j] : rate) += slope[j] * slope[j];
    }
    if constexpr (D == 3) {
        const float* r = leaf.depth;
        double own = 0;
        for (double s : {0.0, (double)leaf.w})
            for (double t : {0.0, (double)leaf.h}) own = std::max(own, fabs(r[0] + s * r[1] + t * (r[2] + s * r[3])));
        e.rate = std::max(e.rate, sqrt(rate + own * own));
    }
    e.spread = std::max(e.spread, spread[0] + spread[1]);
    // No eigenvalue of MMᵀ is above that of the bounds of its entries.
    auto entry = [&](int a, int b) { return slopes[a][0] * slopes[b][0] + slopes[a][1] * slopes[b][1]; };
    const double half = (entry(0, 0) + entry(1, 1)) / 2, off = (entry(0, 0) - entry(1, 1)) / 2;
    e.largest = std::max(e.largest, half + sqrt(off * off + entry(0, 1) * entry(0, 1)));
    // No eigenvalue of MᵀM is above its trace, and the least is at most the least of its diagonal.
    e.widest = std::max({e.widest, std::min(spread[0], spread[1]), (spread[0] + spread[1]) / 400});
}

template <int D>
Extent<D> Plan<D>::extent(int index) const {
    Extent<D> e;
    const Root& root = roots[index];
    if (root.first_pixel >= 0)
        return bands[root.band].extents[(size_t)(index / across % BAND) * across + index % across];
    if (root.held) return under->extent(index);
    if (under && root.rim) e |= under->extent(index);
    if (is_still(index) || root.rim) {  // it includes the identity
        int i = index % across, j = index / across;
        double low[3] = {(double)column(i), (double)line(j), z}, high[3] = {column(i + 1) + 1.0, line(j + 1) + 1.0, z};
        for (int d = 0; d < D; d++) {
            e.low[d] = std::min(e.low[d], low[d]);
            e.high[d] = std::max(e.high[d], high[d]);
        }
    }
    for (int l = root.first; l >= 0; l = bands[root.band].next[l]) widen(bands[root.band].leaves[l], e);
    return e;
}

template <int D>
Extent<D> Plan<D>::extent() const {
    Extent<D> all;
    for (const Band& b : bands) all |= b.extent;
    return all;
}

template <int D>
Checks Plan<D>::measure(double finest) const {
    std::vector<Checks> found(down);
    const Chain chain = all.chain();
    const double spacing = finest_of<D>(axes.data());
    Grid grid;
    grid.size[0] = width;
    grid.size[1] = height;
    parallel(down, [&](int j, int) {
        each_row(grid, j, {box[0], box[1], box[2], box[3]}, Slopes::NONE,
                 [&](const Row<D>& row, int x, int y, int n, int at) {
                     if (row.idle) return;
                     for (int start = 0; start < n; start += LANES) {
                         Lanes q[D], given[D] = {}, off{};
                         Solution<D, Lanes> exact{};
                         for (int i = 0; i < LANES; i++) {
                             int k = std::min(start + i, n - 1);
                             for (int d = 0; d < D; d++) {
                                 given[d][i] = row.whole[d][at + k] + (double)row.part[d][at + k];
                                 exact.p[d][i] = given[d][i] * axes[d].spacing;
                                 q[d][i] = (d == 0 ? x + k : d == 1 ? y : z) * axes[d].spacing;
                             }
                         }
                         if (map) {
                             auto jet = jet_at<D, 0>(q);
                             exact.done = pass<D>(*map, true, jet).done;
                             for (int d = 0; d < D; d++) exact.p[d] = jet.x[d];
                         } else
                             newton<D>(chain, axes.data(), q, finest * spacing, 8, exact, 1e-3 * spacing);
                         if (!map && any(without(Mask{} == 0, exact.done))) {
                             Solution<D, Lanes> again;
                             undo<D>(chain, axes.data(), q, finest * spacing, again);
                             for (int d = 0; d < D; d++) exact.p[d] = choose(exact.done, exact.p[d], again.p[d]);
                             exact.done = either(exact.done, again.done);
                         }
                         for (int d = 0; d < D; d++) {
                             Lanes e = exact.p[d] / axes[d].spacing - given[d];
                             off += e * e;
                         }
                         for (int i = 0; i < LANES && start + i < n; i++) {
                             found[j].unsolved += !exact.done[i];
                             found[j].error = std::max(found[j].error, sqrt(off[i]) + finest);
                         }
                     }
                 });
    });
    Checks sum;
    sum.error = finest;
    for (const Checks& f : found) sum |= f;
    return sum;
}

template class Plan<2>;
template class Plan<3>;

}  // namespace supple
