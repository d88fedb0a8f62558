// Which of the core's modules this processor runs. Compiled for any processor of the architecture, so that one that is
// too old gets a sentence rather than an illegal instruction.
#include <Python.h>

namespace {

PyObject* isas(PyObject*, PyObject*) {
#if defined(__x86_64__) || defined(_M_X64)
    __builtin_cpu_init();
    const bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    const bool v3 =
        v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    const bool v4 = v3 && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
                    __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512cd");
    return v4   ? Py_BuildValue("(sss)", "v4", "v3", "v2")
           : v3 ? Py_BuildValue("(ss)", "v3", "v2")
           : v2 ? Py_BuildValue("(s)", "v2")
                : Py_BuildValue("()");
#else
    return Py_BuildValue("(s)", "base");
#endif
}

PyMethodDef functions[] = {
    {"isas", isas, METH_NOARGS, "Return the instruction sets that this processor runs, best first."},
    {nullptr, nullptr, 0, nullptr}};
PyModuleDef module = {PyModuleDef_HEAD_INIT, "cpu", nullptr, 0, functions, nullptr, nullptr, nullptr, nullptr};

}  // namespace

PyMODINIT_FUNC PyInit_cpu() { return PyModuleDef_Init(&module); }
