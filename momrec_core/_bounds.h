/* The lesser and the greater of two numbers: unlike fmin and fmax, an instruction and no call. */

#ifndef MOMREC_BOUNDS_H
#define MOMREC_BOUNDS_H

/* Both return the second where one is no number. */
static inline double lesser(double one, double other) { return one < other ? one : other; }
static inline double greater(double one, double other) { return one > other ? one : other; }

#endif
