/* A sample of predictive steering in one call: prepared, solved by HPIPM on arrays in place, checked.

   What is computed stands in Python: `prepare` and `check` are generated from CasADi functions, and which number goes
   where is read from tables of places. */
#include <math.h>
#include <string.h>

typedef int (*Generated)(const double **, double **, long long *, double *, int);
typedef struct { Generated run; const double **arg; double **res; long long *iw; double *w; } Bound;
typedef void (*Setter)(int, double *, void *);
typedef void (*Getter)(int, void *, double *);
typedef struct { void *call; long long stage, first, size; } Part;

typedef struct {
  const Part *set, *get;
  long long sets, gets, answers;
  const long long *from, *plus, *minus; /* places in data of what is set; in told, of an answer's two terms */
  const double *sign, *data;
  double *now, *before, *told, *answer;
  void *qp, *sol, *options, *work;
  void (*solve)(void *, void *, void *, void *);
  void (*status)(void *, int *), (*iterations)(void *, int *);
} Stages;

typedef struct {
  Stages *stages;
  Bound *prepare, *check;
  const double *by_speed, *cornering; /* tables, a row a speed */
  long long row, corners, row_arg, corners_arg; /* their widths, and which arguments of `prepare` they are */
  long long given, fresh, gaps, ahead, rates;
  const long long *where, *from, *gap, *rate; /* places: of what is fresh, in data and in it; of gaps; of rates */
  double *inputs, *data;
  const double *prepared, *found, *answer, *residual;
} Programme;

static void run(const Bound *b) { b->run(b->arg, b->res, b->iw, b->w, 0); }

/* said: success, iterations. Only what has changed since the last call is told to the solver. */
void solve(Stages *s, double *said)
{
  for (const Part *p = s->set; p < s->set + s->sets; p++) {
    double *now = s->now + p->first, *before = s->before + p->first;
    for (long long i = 0; i < p->size; i++) now[i] = s->sign[p->first + i] * s->data[s->from[p->first + i]];
    if (memcmp(now, before, p->size * sizeof *now)) {
      memcpy(before, now, p->size * sizeof *now);
      ((Setter)p->call)((int)p->stage, now, s->qp);
    }
  }
  int status, iterations;
  s->solve(s->qp, s->sol, s->options, s->work);
  s->status(s->work, &status);
  s->iterations(s->work, &iterations);
  for (const Part *p = s->get; p < s->get + s->gets; p++) ((Getter)p->call)((int)p->stage, s->sol, s->told + p->first);
  for (long long i = 0; i < s->answers; i++) s->answer[i] = s->told[s->plus[i]] - s->told[s->minus[i]];
  said[0] = status == 0;
  said[1] = iterations;
}

/* in: 0 nothing, 1 prediction, 2 solution; the piece of the tables; the inputs of `prepare`.
   out: success, iterations, residual; what is ahead; the rates. */
void programme(Programme *p, const double *in, double *out)
{
  memset(out, 0, (3 + p->ahead + p->rates) * sizeof *out);
  if (!(in[0] > 0.0)) return;
  const long long piece = (long long)in[1];
  p->prepare->arg[p->row_arg] = p->by_speed + piece * p->row;
  p->prepare->arg[p->corners_arg] = p->cornering + piece * p->corners;
  memcpy(p->inputs, in + 2, p->given * sizeof *in);
  run(p->prepare);
  memcpy(out + 3, p->prepared, p->ahead * sizeof *out);
  if (in[0] < 2.0) return;
  for (long long i = 0; i < p->fresh; i++) p->data[p->where[i]] = p->found[p->from[i]];
  double sum = 0.0;
  for (long long i = 0; i < p->gaps; i++) sum += p->data[p->gap[i]];
  if (!isfinite(sum)) { out[2] = INFINITY; return; }
  solve(p->stages, out);
  run(p->check);
  out[2] = *p->residual;
  for (long long i = 0; isfinite(out[2]) && i < p->rates; i++) out[3 + p->ahead + i] = p->answer[p->rate[i]];
}
