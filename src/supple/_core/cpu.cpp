// The choice of the core's module for this processor. Compiled for any processor of the architecture, so that old ones
// get an error message, not an illegal instruction. No __builtin_cpu_supports: not every compiler links it.
#include <Python.h>
#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>
#endif

namespace {

#if defined(__x86_64__) || defined(_M_X64)
constexpr bool all(unsigned value, unsigned bits) { return (value & bits) == bits; }

// The highest level of x86-64 (as the psABI defines them) that processor and system have.
int level() {
    unsigned a, b, c = 0, d, b7 = 0, c7, d7, extended = 0;
    __get_cpuid(1, &a, &b, &c, &d);
    __get_cpuid_count(7, 0, &a, &b7, &c7, &d7);
    __get_cpuid(0x80000001u, &a, &b, &extended, &d);
    if (!all(c, bit_SSE3 | bit_SSSE3 | bit_SSE4_1 | bit_SSE4_2 | bit_POPCNT | bit_CMPXCHG16B)) return 1;
    // The system must save the wide registers too: bits of XCR0.
    unsigned saved = 0, high;
    if (all(c, bit_OSXSAVE)) __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if (!all(saved, 0x6) || !all(c, bit_AVX | bit_FMA | bit_F16C | bit_MOVBE)) return 2;
    if (!all(b7, bit_AVX2 | bit_BMI | bit_BMI2) || !all(extended, bit_LZCNT)) return 2;
    return 3;
}

PyObject* isas(PyObject*, PyObject*) {
    switch (level()) {
        case 3: return Py_BuildValue("(ss)", "v3", "v2");
        case 2: return Py_BuildValue("(s)", "v2");
        default: return Py_BuildValue("()");
    }
}
#else
PyObject* isas(PyObject*, PyObject*) { return Py_BuildValue("(s)", "base"); }
#endif

PyMethodDef functions[] = {
    {"isas", isas, METH_NOARGS, "Return the instruction sets that this processor runs, best first."},
    {nullptr, nullptr, 0, nullptr}};
PyModuleDef module = {PyModuleDef_HEAD_INIT, "cpu", nullptr, 0, functions, nullptr, nullptr, nullptr, nullptr};

}  // namespace

PyMODINIT_FUNC PyInit_cpu() { return PyModuleDef_Init(&module); }
