/* Episodes of cars, LANES at a time: what `episode_code` puts in front of it drives, observes, judges and begins them.
 *
 * In front of it stand: the types real and mask, LANES, SELECT, load, store; the functions of the traced task, tick0 and
 * so on, look, begin and judge; and as macros COLUMNS (of an observation), ROWS (of signals: those columns, then INFOS
 * more), CARRIED (numbers of state of a car), AGENT (where among them the action is), PLACE (the row of s), RANDOM
 * (numbers of random state of a start), STREAMS (those they are of), BOUND (of an observation), BEGINNING (whether
 * starts are there), TICKS(s) (a sample).
 */
#include <pthread.h>
#include <stdint.h>
typedef struct {
  const double *mid, *half;       /* [COLUMNS] */
  const double *action;           /* [cars]; rad */
  double *state, *signals;        /* [groups][CARRIED][LANES], [groups][ROWS][LANES] */
  float *observation, *last_observation;  /* [cars][COLUMNS] */
  double *info, *last_info;       /* [INFOS][padded] */
  double *reward, *cost;          /* [padded] */
  long long *steps;
  unsigned char *terminated, *truncated, *over;
  uint64_t *seed;                 /* of the starts that are given, with s, e, psi_e in `start` [padded][3] */
  double *start;
  void *const *generator;         /* [cars]: NumPy's bit generators */
  uint32_t (*next_uint32)(void *);
  double (*next_double)(void *);
  double failure, longest, end;   /* a failure's cost; the longest episode [steps]; where the course ends [m] */
  double far, start_e, start_psi_e;  /* largest s [m], |e| [m] and |psi_e| [rad] of a start */
  long long cars, padded, groups;
} fleet;
typedef struct { const fleet *f; long long first, last; int how; } part;
enum { NEXT_STEP, SAME_STEP, DISABLED };
static uint64_t mixed(uint64_t z)
{
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}
/* one of `streams` of a seed, as steerkit._support.random.seed_state */
static void seeded(uint64_t seed, uint64_t stream, real *states, int lane)
{
  uint64_t z = mixed(seed) ^ mixed(stream + 0x5EED);
  for (int i = 0; i < 6; i++) {
    z += 0x9E3779B97F4A7C15u;
    states[i][lane] = (double)(1 + mixed(z) % (i < 3 ? 4294967086u : 4294944442u));
  }
}
static const uint64_t streams[] = { STREAMS };
/* draws a start as Task.draw does: the seed, the place, its e, its turn */
static void draw(const fleet *f, long long car)
{
  void *g = f->generator[car];
  f->seed[car] = f->next_uint32(g) >> 1;
  double *to = f->start + 3 * car;
  const double s = f->next_double(g) * f->far;
  to[0] = BEGINNING ? 0.0 : s;
  to[1] = -f->start_e + 2.0 * f->start_e * f->next_double(g);
  to[2] = f->start_psi_e * (-1.0 + 2.0 * f->next_double(g));
}
static void observed(float *to, const fleet *f, const real *v, int lane)
{
  for (int c = 0; c < COLUMNS; c++) {
    const double scaled = (v[c][lane] - f->mid[c]) / f->half[c];
    to[c] = (float)(scaled < -BOUND ? -BOUND : scaled > BOUND ? BOUND : scaled);
  }
}
/* puts the lanes of `which` where `start` says */
static void begun(const fleet *f, long long group, mask which, real *s, real *v)
{
  real given[3 + RANDOM], new_s[CARRIED], new_v[ROWS];
  for (int l = 0; l < LANES; l++) {
    const long long car = group * LANES + l;
    for (int i = 0; i < 3; i++) given[i][l] = f->start[3 * car + i];
    for (int i = 0; i < RANDOM / 6; i++) seeded(f->seed[car], streams[i], given + 3 + 6 * i, l);
  }
  begin(given, new_s, new_v);
  for (int i = 0; i < CARRIED; i++) s[i] = SELECT(which, new_s[i], s[i]);
  for (int i = 0; i < ROWS; i++) v[i] = SELECT(which, new_v[i], v[i]);
  for (int l = 0; l < LANES; l++)
    if (which[l]) f->steps[group * LANES + l] = 0, f->cost[group * LANES + l] = 0.0;
}
static void kept(const fleet *f, long long group, const real *s, const real *v)
{
  for (int i = 0; i < CARRIED; i++) store(f->state + (group * CARRIED + i) * LANES, s[i]);
  for (int i = 0; i < ROWS; i++) store(f->signals + (group * ROWS + i) * LANES, v[i]);
  for (int i = 0; i < INFOS; i++) store(f->info + i * f->padded + group * LANES, v[COLUMNS + i]);
  for (int l = 0; l < LANES; l++)
    if (group * LANES + l < f->cars) observed(f->observation + (group * LANES + l) * COLUMNS, f, v, l);
}
static void stepped(const fleet *f, long long group, int how)
{
  real s[CARRIED], v[ROWS], before[ROWS], cost, failed;
  mask anew;
  const long long car0 = group * LANES;
  for (int i = 0; i < CARRIED; i++) s[i] = load(f->state + (group * CARRIED + i) * LANES);
  for (int i = 0; i < ROWS; i++) before[i] = load(f->signals + (group * ROWS + i) * LANES);
  const real action = load(f->action + car0);
  s[AGENT] = action;
  TICKS(s)
  look(s, v);
  judge(before, action, v, &cost, &failed);
  store(f->cost + car0, cost);
  for (int l = 0; l < LANES; l++) {
    const long long car = car0 + l;
    const unsigned char out = failed[l] != 0, was = f->over[car];
    const unsigned char late = ++f->steps[car] >= f->longest || v[PLACE][l] >= f->end;
    const unsigned char end = (out || late) && !(how == NEXT_STEP && was);
    anew[l] = (how == NEXT_STEP ? was : how == SAME_STEP && end) ? -1 : 0;
    f->reward[car] = how == NEXT_STEP && was ? 0.0 : out ? -f->failure : -cost[l];
    f->terminated[car] = out && end;
    f->truncated[car] = !out && end;
    f->over[car] = end && how != SAME_STEP;
    if (anew[l] && car < f->cars) {
      if (how == SAME_STEP) {
        observed(f->last_observation + car * COLUMNS, f, v, l);
        for (int i = 0; i < INFOS; i++) f->last_info[i * f->padded + car] = v[COLUMNS + i][l];
        f->last_info[INFOS * f->padded + car] = (double)f->steps[car];
        f->last_info[(INFOS + 1) * f->padded + car] = cost[l];
      }
      draw(f, car);
    }
  }
  int any = 0;
  for (int l = 0; l < LANES; l++) any |= anew[l] != 0;
  if (any) begun(f, group, anew, s, v);
  kept(f, group, s, v);
}
static void *work(void *given)
{
  const part *p = given;
  for (long long group = p->first; group < p->last; group++) stepped(p->f, group, p->how);
  return 0;
}
void step(const fleet *f, int how, int threads)
{
  part parts[64];
  pthread_t ids[64];
  int running[64];
  for (int i = threads - 1; i >= 0; i--) {
    parts[i] = (part){ f, f->groups * i / threads, f->groups * (i + 1) / threads, how };
    running[i] = i > 0 && pthread_create(ids + i, 0, work, parts + i) == 0;
    if (!running[i]) work(parts + i);
  }
  for (int i = 1; i < threads; i++) if (running[i]) pthread_join(ids[i], 0);
}
/* begins the episodes of the cars of `which`, where `start` says */
void place(const fleet *f, const unsigned char *which)
{
  for (long long group = 0; group < f->groups; group++) {
    real s[CARRIED], v[ROWS];
    mask anew;
    for (int i = 0; i < CARRIED; i++) s[i] = load(f->state + (group * CARRIED + i) * LANES);
    for (int i = 0; i < ROWS; i++) v[i] = load(f->signals + (group * ROWS + i) * LANES);
    for (int l = 0; l < LANES; l++) anew[l] = which[group * LANES + l] ? -1 : 0;
    begun(f, group, anew, s, v);
    kept(f, group, s, v);
    for (int l = 0; l < LANES; l++) if (anew[l]) f->over[group * LANES + l] = 0;
  }
}
int lanes(void) { return LANES; }
