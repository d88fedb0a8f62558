// Triangles and lines in front of the camera of a volume: the nearest one of each ray, and its light.
//
// In millimetres along the volume's axes from the eye, a point is P = X right + Y down + Z ahead, and a ray is
// d = x right + y down + ahead, for a pixel (x, y). With w_i = d · (P_j × P_k), the ray meets the plane of a triangle
// at Σ w_i P_i / Σ w_i, and the triangle if no two w_i differ in sign: this is exact in perspective, and corners behind
// the eye need no special case. Triangles that share an edge have the same w for it up to the sign, so no ray passes
// between them.
#pragma once
#include "raymarch.hpp"
#include "threads.hpp"

namespace supple {

constexpr int STRIP = 16;            // rows of rays that a thread draws
constexpr int CHUNK = 1 << 14;       // triangles and lines that a thread sorts into strips
constexpr double BEFORE_EYE = 1e-6;  // millimetres: where lines begin that go through the eye's plane
constexpr float SMOOTH = 0.766f;     // cos 40°: a corner whose normal differs more from the triangle's is on an edge

struct Mesh {
    const double* points;  // millimetres along the volume's axes
    int64_t count;
    const float* normals;  // of points, of unit length or 0
    const int32_t* triangles;
    int64_t triangle_count;
    const int32_t* lines;
    int64_t line_count;
    Float4 colour;  // in linear light
    double radius;  // of lines, in pixels
};

// The rays of a picture, as pixel positions from its centre.
struct Rays {
    const double *columns, *rows;
    int width, height;
};

// A point x right + y down + z ahead of the eye: z is in millimetres, and (x / z, y / z) is its pixel.
struct Seen {
    double x, y, z;
    friend Seen cross(Seen a, Seen b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
    Seen operator-() const { return {-x, -y, -z}; }
    bool operator<(const Seen& o) const { return x != o.x ? x < o.x : y != o.y ? y < o.y : z < o.z; }
};

// Clip a line to the part in front of the eye; false if there is none.
inline bool clip(Seen& a, Seen& b) {
    if (a.z < BEFORE_EYE && b.z < BEFORE_EYE) return false;
    for (Seen* p : {&a, &b}) {
        if (p->z >= BEFORE_EYE) continue;
        const Seen& q = p == &a ? b : a;
        double s = (BEFORE_EYE - p->z) / (q.z - p->z);
        *p = {p->x + s * (q.x - p->x), p->y + s * (q.y - p->y), BEFORE_EYE};
    }
    return true;
}

// The range of pixels that an item covers.
struct Covered {
    double left = NEVER, right = -NEVER, top = NEVER, bottom = -NEVER;
    void add(Seen a, Seen b, double around) {
        if (!clip(a, b)) return;
        for (const Seen& p : {a, b}) {
            left = least(left, p.x / p.z - around);
            right = most(right, p.x / p.z + around);
            top = least(top, p.y / p.z - around);
            bottom = most(bottom, p.y / p.z + around);
        }
    }
};

class Raster {
public:
    // Draw a mesh into the ends of rays: red, green and blue in linear light, and millimetres from the eye.
    Raster(const Look& look, const Rays& rays, const Mesh& mesh, float* out)
        : look(look), rays(rays), mesh(mesh), out(out), seen(mesh.count) {
        const Double4 axes[] = {look.right, look.down, look.ahead};
        Double4 eye = look.eye * look.spacing, over;
        for (int k = 0; k < 3; k++)
            over[k] = 1 / (axes[k][0] * axes[k][0] + axes[k][1] * axes[k][1] + axes[k][2] * axes[k][2]);
        auto chunks = [](int64_t n) { return int((n + CHUNK - 1) / CHUNK); };
        parallel(chunks(mesh.count), [&](int chunk, int) {
            for (int64_t i = int64_t(chunk) * CHUNK; i < least(int64_t(chunk + 1) * CHUNK, mesh.count); i++) {
                double p[3] = {};
                for (int k = 0; k < 3; k++) {
                    for (int c = 0; c < 3; c++) p[k] += (mesh.points[3 * i + c] - eye[c]) * axes[k][c];
                    p[k] *= over[k];
                }
                seen[i] = {p[0], p[1], p[2]};
            }
        });
        const int64_t items = mesh.triangle_count + mesh.line_count;
        const int strips = (rays.height + STRIP - 1) / STRIP, parts = chunks(items);
        // In each strip, items are drawn in their order, whatever thread has sorted them.
        std::vector<std::vector<int64_t>> lists(size_t(strips) * parts);
        parallel(parts, [&](int part, int) {
            for (int64_t i = int64_t(part) * CHUNK; i < least(int64_t(part + 1) * CHUNK, items); i++) {
                auto [first, last] = within(rays.rows, rays.height, covered(i).top, covered(i).bottom);
                for (int strip = first / STRIP; first <= last && strip <= last / STRIP; strip++)
                    lists[size_t(strip) * parts + part].push_back(i);
            }
        });
        parallel(strips, [&](int strip, int) {
            const int top = strip * STRIP, bottom = least(top + STRIP, rays.height) - 1;
            for (int part = 0; part < parts; part++)
                for (int64_t i : lists[size_t(strip) * parts + part])
                    i < mesh.triangle_count ? triangle(i, top, bottom) : line(i, top, bottom);
        });
    }

private:
    const Look& look;
    const Rays& rays;
    const Mesh& mesh;
    float* out;
    std::vector<Seen> seen;

    const int32_t* corners(int64_t i) const {
        return i < mesh.triangle_count ? mesh.triangles + 3 * i : mesh.lines + 2 * (i - mesh.triangle_count);
    }
    Covered covered(int64_t i) const {
        const int32_t* at = corners(i);
        const bool line = i >= mesh.triangle_count;
        Covered all;
        for (int k = 0; k < (line ? 1 : 3); k++)
            all.add(seen[at[k]], seen[at[line ? 1 : (k + 1) % 3]], line ? mesh.radius : 0);
        return all;
    }
    // The first and the last of evenly spaced positions in a range; rounding may add one at each end.
    static std::pair<int, int> within(const double* at, int n, double low, double high) {
        if (!(low <= high)) return {0, -1};
        double per = n > 1 ? (n - 1) / (at[n - 1] - at[0]) : 1;
        auto place = [&](double x) { return least(most(floored((x - at[0]) * per), -2.0), double(n)); };
        return {most(int(place(low)), 0), least(int(place(high)) + 1, n - 1)};
    }

    // Call f(row, first column, last column) for each row of an item between two rows.
    template <class F>
    INLINE void cover(int64_t i, int top, int bottom, F&& f) const {
        const Covered all = covered(i);
        auto [left, right] = within(rays.columns, rays.width, all.left, all.right);
        auto [first, last] = within(rays.rows, rays.height, all.top, all.bottom);
        for (int y = most(first, top); y <= least(last, bottom); y++) f(y, left, right);
    }

    void triangle(int64_t i, int top, int bottom) const {
        const int32_t* at = corners(i);
        const Seen p[3] = {seen[at[0]], seen[at[1]], seen[at[2]]};
        Seen n[3];
        for (int k = 0; k < 3; k++) {
            const int a = (k + 1) % 3, b = (k + 2) % 3;
            n[k] = p[a] < p[b] ? cross(p[a], p[b]) : -cross(p[b], p[a]);
        }
        cover(i, top, bottom, [&](int row, int left, int right) {
            double y = rays.rows[row], from[3];
            for (int k = 0; k < 3; k++) from[k] = n[k].y * y + n[k].z;
            for (int column = left; column <= right; column++) {
                double x = rays.columns[column], w[3];
                for (int k = 0; k < 3; k++) w[k] = n[k].x * x + from[k];
                bool one = w[0] >= 0 && w[1] >= 0 && w[2] >= 0, other = w[0] <= 0 && w[1] <= 0 && w[2] <= 0;
                if (!one && !other) continue;
                double over = 1 / (w[0] + w[1] + w[2]), z = 0;
                for (int k = 0; k < 3; k++) z += (w[k] *= over) * p[k].z;
                hit(row, column, z, [&](Double4 along) { return lit(normal(at, w), along); });
            }
        });
    }

    void line(int64_t i, int top, int bottom) const {
        const int32_t* at = corners(i);
        Seen a = seen[at[0]], b = seen[at[1]];
        if (!clip(a, b)) return;
        double ax = a.x / a.z, ay = a.y / a.z, dx = b.x / b.z - ax, dy = b.y / b.z - ay, length2 = dx * dx + dy * dy;
        cover(i, top, bottom, [&](int row, int left, int right) {
            for (int column = left; column <= right; column++) {
                double x = rays.columns[column] - ax, y = rays.rows[row] - ay;
                double s = length2 > 0 ? least(most((x * dx + y * dy) / length2, 0.0), 1.0) : 0;
                x -= s * dx;
                y -= s * dy;
                if (x * x + y * y > mesh.radius * mesh.radius) continue;
                hit(row, column, 1 / mix(s, 1 / a.z, 1 / b.z), [&](Double4) { return mesh.colour; });
            }
        });
    }

    // Set the end of a ray to the point z ahead of the eye, if nothing nearer is there.
    template <class F>
    INLINE void hit(int row, int column, double z, F&& colour) const {
        Double4 along = look.ahead + rays.columns[column] * look.right + rays.rows[row] * look.down;
        double length = root(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
        float* to = out + 4 * (int64_t(row) * rays.width + column);
        const float away = float(z * length);
        if (!(away > 0 && away < to[3])) return;
        Float4 made = colour(along * (1 / length));
        made[3] = away;
        memcpy(to, &made, sizeof made);
    }

    // The normal at a point of a triangle: from the normals of its corners, but its own for corners on an edge.
    INLINE Float4 normal(const int32_t* at, const double* weights) const {
        double p[3][3];
        for (int k = 0; k < 3; k++) memcpy(p[k], mesh.points + 3 * int64_t(at[k]), sizeof p[k]);
        Double4 own{};
        for (int c = 0; c < 3; c++) {
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            own[c] = (p[1][d] - p[0][d]) * (p[2][e] - p[0][e]) - (p[1][e] - p[0][e]) * (p[2][d] - p[0][d]);
        }
        own *= 1 / root(own[0] * own[0] + own[1] * own[1] + own[2] * own[2]);
        const Float4 flat = floats(own);
        Float4 sum{};
        for (int k = 0; k < 3; k++) {
            const float* n = mesh.normals + 3 * int64_t(at[k]);
            Float4 corner = {n[0], n[1], n[2], 0};
            const float angle = dot3(corner, flat);
            sum += float(weights[k]) * (__builtin_fabsf(angle) < SMOOTH ? flat : angle < 0 ? -corner : corner);
        }
        return sum;
    }

    // The light of a surface with a normal, as in `Beam::shade`.
    INLINE Float4 lit(Float4 normal, Double4 along) const {
        if (!look.shaded) return mesh.colour;
        const Float4 way = floats(along), half = look.lamp - way;
        const float over = 1 / root(dot3(normal, normal));
        const float aside = most(1 - __builtin_fabsf(dot3(normal, way) * over), 0.0f);
        float shine = dot3(normal, half) * over / most(root(dot3(half, half)), 1e-6f);
        for (int i = 0; i < 4; i++) shine *= shine;
        return (mesh.colour * (AMBIENT + DIFFUSE * __builtin_fabsf(dot3(normal, look.lamp) * over)) +
                SPECULAR * shine) *
               (1 - look.silhouettes * aside * aside);
    }
};

}  // namespace supple
