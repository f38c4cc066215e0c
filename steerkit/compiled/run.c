/* Ticks of cars in groups of LANES: follows generated `tick0`, `tick1`, ..., the sizes and CASES, which call them. */
int lanes(void) { return LANES; }
/* slots, parameters, all: one block of [count][LANES] a group; out: [rows][recorded][cars] */
void run(long long k0, long long stop, long long every, long long first, long long last, long long cars,
         double *slots, const double *parameters, double *out, void **routines)
{
  for (long long group = first; group < last; group++) {
    real s[PERSISTENT], p[PARAMETERS];
    long long wait = (every - k0 % every) % every;
    double *to = out + group * LANES;
    for (int i = 0; i < CARRIED; i++) s[i] = load(slots + (group * CARRIED + i) * LANES);
    for (int i = 0; i < GIVEN; i++) p[i] = load(parameters + (group * GIVEN + i) * LANES);
    for (long long k = k0; k < stop; k++) {
      real y[RECORDED];
      switch (k % PERIOD) { CASES }
      if (wait == 0) { for (int i = 0; i < KEPT; i++, to += cars) store(to, y[i]); wait = every; }
      wait--;
    }
    for (int i = 0; i < CARRIED; i++) store(slots + (group * CARRIED + i) * LANES, s[i]);
  }
}
