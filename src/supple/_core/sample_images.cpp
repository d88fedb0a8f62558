#include "bindings.hpp"

namespace supple {
void sample_plane(const Plan<2>& plan, const Job& job) { sample(plan, job); }
}  // namespace supple
