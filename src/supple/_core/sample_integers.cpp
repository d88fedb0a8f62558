#define SAMPLING
#include "bindings.hpp"

namespace supple {
SAMPLES_AS(, uint8_t)
SAMPLES_AS(, uint16_t)
}  // namespace supple
