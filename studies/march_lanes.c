/* Marches vehicles in lockstep, a lane each.  Included after march.c and the step in lanes, by batch.c. */

/* Sorted by the length of their traces, runs of a group end at nearly the same time. */
static void march_group(const batch *b, long first) {
  double state[2][HS_NX * HS_LANES] LINED, u[HS_NU * HS_LANES] LINED, q[HS_NL * HS_LANES] LINED, y[(HS_NY + 1) * HS_LANES] LINED;
  double sum[(HS_SUM + 1) * HS_LANES] LINED, max[(HS_MAX + 1) * HS_LANES] LINED, min[(HS_MIN + 1) * HS_LANES] LINED;
