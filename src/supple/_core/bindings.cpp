// What Python sees of the core.
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include <charconv>
#include <cstdlib>
#include <string_view>
#include <thread>
#include <vector>

#if defined(__linux__)
#include <sched.h>
#endif

namespace nb = nanobind;

namespace {

// How many processors this process may use.
int processors() {
#if defined(__linux__)
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
#endif
    const unsigned n = std::thread::hardware_concurrency();
    return n ? static_cast<int>(n) : 1;
}

// SUPPLE_THREADS if that is a positive number, else one for each processor; read at each call.
int threads() {
    if (const char* text = std::getenv("SUPPLE_THREADS")) {
        const std::string_view asked(text);
        int n = 0;
        const auto [end, error] = std::from_chars(asked.data(), asked.data() + asked.size(), n);
        if (error == std::errc() && end == asked.data() + asked.size() && n > 0) return n;
    }
    return processors();
}

// A polynomial c0 + c1 x + c2 x² + ...
class Polynomial {
public:
    explicit Polynomial(std::vector<double> coefficients) : coefficients_(std::move(coefficients)) {}

    double at(double x) const {
        double sum = 0;
        for (auto c = coefficients_.rbegin(); c != coefficients_.rend(); ++c) sum = sum * x + *c;
        return sum;
    }

private:
    std::vector<double> coefficients_;
};

}  // namespace

namespace supple {
void bind_folds(nb::module_& m);
}

NB_MODULE(SUPPLE_MODULE, m) {
    supple::bind_folds(m);
    m.def("threads", &threads, "Return how many threads work at once.");
    nb::class_<Polynomial>(m, "Polynomial", "A polynomial, by its coefficients from the constant one on.")
        .def(nb::init<std::vector<double>>(), nb::arg("coefficients"))
        .def("at", &Polynomial::at, nb::arg("x"), "Return its value at ``x``.");
}
