/* The arm by itself, for a stand-in that is no library. */

#include "world.h"

size_t stand_in_size(void) { return sizeof(world); }
void stand_in_advance(world *w) {
    world_lock(w);
    world_advance(w);
    world_unlock(w);
}
int stand_in_read(world *w, double *position, double *velocity) { return world_read(w, position, velocity); }
void stand_in_push(world *w, const double *force) { world_push(w, force); }
