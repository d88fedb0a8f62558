// Data for kernels that other compilers compile: maps in one block of memory, and constants.
#include "bindings.hpp"
#include "map.hpp"

namespace supple {
namespace {

// A growing block of memory that will be copied to a given address.
class Block {
public:
    explicit Block(uint64_t base) : base(base) {}

    // Make room for n values, copied from `from` unless it is null, and return their future address.
    template <class T>
    T* put(const T* from, size_t n) {
        size_t at = (bytes.size() + 15) / 16 * 16;
        bytes.resize(at + n * sizeof(T));
        if (from && n) memcpy(bytes.data() + at, from, n * sizeof(T));
        return (T*)(base + at);
    }
    // Write a value where `put` made room.
    template <class T>
    void set(T* at, const T& value) {
        memcpy(bytes.data() + ((uint64_t)at - base), &value, sizeof value);
    }
    const char* data() const { return bytes.data(); }
    size_t size() const { return bytes.size(); }

private:
    uint64_t base;
    std::vector<char> bytes;
};

const Freeze* flattened(Block& block, const Frozen& from) {
    Freeze mask = from;
    const size_t count = (size_t)from.size[0] * from.size[1] * from.size[2];
    mask.values = block.put(from.values, count);
    mask.calm = block.put(from.calm, count);
    return block.put(&mask, 1);
}

Chain flattened(Block& block, const Chain& from, const Freeze* mask) {
    std::vector<Stroke> strokes;
    std::vector<int> list;
    for (int i = 0; i < from.count; i++) {
        strokes.push_back(from[i]);
        list.push_back(i);
        if (!from[i].freeze) continue;
        strokes.back().freeze = mask;
    }
    return {block.put(strokes.data(), strokes.size()), block.put(list.data(), list.size()), from.count};
}

size_t bytes_of(const Sampled& field, int ndim) {
    return (size_t)field.size[0] * field.size[1] * field.size[2] * ndim * (field.wide ? 8 : 4);
}

const Composite* flattened(Block& block, const Composed& from, const Freeze* mask) {
    std::vector<Part> parts(from.parts, from.parts + from.count);
    for (Part& part : parts) {
        part.chain = flattened(block, part.chain, mask);
        if (part.kind == FIELD)
            part.field.values = block.put((const char*)part.field.values, bytes_of(part.field, from.ndim));
    }
    Composite map = from;
    map.parts = block.put(parts.data(), parts.size());
    return block.put(&map, 1);
}

// One block of maps, which begins with a `Map` for each.
nb::bytes flatten(nb::list maps, uint64_t base) {
    Block block(base);
    Map* first = block.put((const Map*)nullptr, maps.size());
    for (nb::handle h : maps) {
        const auto& [strokes, ndim, freeze, composite] = nb::cast<const Mapping&>(h);
        bool subject = composite && freeze;
        Map map{};
        map.limited = true;
        for (const Stroke& k : strokes.table) {
            subject = subject || k.freeze;
            map.limited = map.limited && k.per_reach > 0;
        }
        const Freeze* mask = subject ? flattened(block, *freeze) : nullptr;
        map.freeze = composite ? nullptr : mask;
        map.chain = flattened(block, strokes.chain(), mask);
        if (composite) map.composite = flattened(block, *composite, mask);
        std::copy(strokes.axes.begin(), strokes.axes.end(), map.axes);
        block.set(first++, map);
    }
    return nb::bytes(block.data(), block.size());
}

}  // namespace

void bind_flat(nb::module_& m) {
    m.def("flatten", &flatten, "maps"_a, "base"_a, "Return maps as one block for a GPU, at an address.");
    nb::dict constants;
    constants["LONGEST"] = (double)LONGEST;
    constants["QUARTIC"] = (double)QUARTIC;
    constants["SINE"] = (double)SINE;
    m.attr("constants") = constants;  // shaders use them, too
}

}  // namespace supple
