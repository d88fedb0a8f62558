#define SOLVING
#include "solvers.hpp"

namespace supple {
SOLVERS(, 2)
SOLVERS(, 3)
}  // namespace supple
