/* The mailbox by itself, for a device whose servo loop is not in C. */

#include "mailbox.h"
