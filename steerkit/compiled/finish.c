/* One tick that gives all slots: follows the generated `last` and the sizes. */
void finish(long long k, long long first, long long end, const double *slots, const double *parameters, double *all,
            void **routines)
{
  for (long long group = first; group < end; group++) {
    real s[PERSISTENT], p[PARAMETERS], out[SLOTS];
    for (int i = 0; i < CARRIED; i++) s[i] = load(slots + (group * CARRIED + i) * LANES);
    for (int i = 0; i < GIVEN; i++) p[i] = load(parameters + (group * GIVEN + i) * LANES);
    last((double)k, s, p, out, routines);
    for (int i = 0; i < SLOTS; i++) store(all + (group * SLOTS + i) * LANES, out[i]);
  }
}
