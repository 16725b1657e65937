/* Queries for one configuration of a robot, and for one motion. These are the most frequent queries, so each is usually
   answered by a single call from Python. An object of the type `Configurations` holds the data that `robots.problem`
   prepared, and is replaced whenever these data change. */

#include "single.h"

#include <math.h>

/* -- Configurations ------------------------------------------------------------------------------------------------ */

typedef struct {
    Holder holder;
    Function check_configurations, check_motion;
    long long pack, problem, memory, piece_pairs;
    int64_t width;
    const double *least, *most; /* Values within these limits cause no warning; a `Watch` may widen them later. */
    Array1 hits;
} Configurations;

/* Return the entries of a configuration. Return NULL if it is not a plain array of the right length, or if one of its
   values would cause an error or a warning. */
static const double *take_configuration(const Configurations *self, PyObject *given)
{
    if (!is_plain(given, 1) || PyArray_DIM((PyArrayObject *)given, 0) != self->width)
        return NULL;
    const double *entries = PyArray_DATA((PyArrayObject *)given);
    for (int64_t k = 0; k < self->width; k++)
        if (!(self->least[k] <= entries[k] && entries[k] <= self->most[k])) /* The comparison is false for NaN. */
            return NULL;
    return entries;
}

/* Return the verdict for a configuration; -1 if Python's general code has to answer. */
static int verdict_of(const Configurations *self, int mode, PyObject *given)
{
    const double *entries = take_configuration(self, given);
    int8_t verdict = CODE_AMBIGUOUS, tier;
    int64_t nothing;
    if (entries == NULL)
        return -1;
    struct check_configurations arguments = {
        .mode = mode, .stop = 1, .Q = {entries, 1, self->width}, .pack = self->pack, .problem_handle = self->problem,
        .out = {&verdict, 1}, .tiers_out = {&tier, 1}, .hits = self->hits, .memory = thread_memory(self->memory),
    };
    if (arguments.memory == NULL ||
        call_kernel(self->check_configurations, &arguments, &nothing, self->piece_pairs > MANY) != 0)
        return -1;
    return mode == CODE_EXACT && verdict == CODE_AMBIGUOUS ? -1 : verdict;
}

/* collide(q) returns a bool, or None if Python's general code has to answer. */
static PyObject *configurations_collide(Configurations *self, PyObject *q)
{
    return answer_of(CODE_EXACT, verdict_of(self, CODE_EXACT, q));
}

/* classify(q) returns the number of a verdict, or None if Python's general code has to answer. */
static PyObject *configurations_classify(Configurations *self, PyObject *q)
{
    return answer_of(CODE_CERTIFY, verdict_of(self, CODE_CERTIFY, q));
}

/* -- motions ------------------------------------------------------------------------------------------------------- */

/* Maximum number of steps of a motion that is checked here. Each thread keeps memory for the results of all steps, and
   longer motions would not be worth more memory. */
#define MOST_STEPS 4096

static PyObject *dist; /* The function math.dist. */

/* Return the distance between two points as Python's `math.dist` computes it; NaN after an exception. */
static double exact_length(PyObject *a, PyObject *b)
{
    PyObject *found = PyObject_CallFunctionObjArgs(dist, a, b, NULL);
    double length = found != NULL ? PyFloat_AsDouble(found) : NAN;
    Py_XDECREF(found);
    return length;
}

/* Return the number of steps of a motion, as `edges.steps` does; 0 if Python's general code has to answer. If the
   quotient is very close to an integer (see NEARLY_WHOLE), rounding may have moved it to the wrong side of this
   integer. The length is then computed again with `math.dist`. */
static int64_t steps_of(PyObject *start, PyObject *end, double step)
{
    const double *a = PyArray_DATA((PyArrayObject *)start), *b = PyArray_DATA((PyArrayObject *)end);
    double squared = 0;
    for (int64_t k = 0; k < PyArray_DIM((PyArrayObject *)start, 0); k++)
        squared += (a[k] - b[k]) * (a[k] - b[k]);
    double steps = sqrt(squared) / step;
    if (fabs(steps - nearbyint(steps)) <= NEARLY_WHOLE * (1 + steps))
        steps = exact_length(start, end) / step;
    return steps <= MOST_STEPS ? (int64_t)fmax(ceil(steps), 1) : 0;
}

/* Call the Python function `order` for the fractions of a motion with `steps` steps. Return a new reference to an
   array; NULL if `steps` is 0, after an exception, or if the result is unusual. */
static PyObject *fractions_of(PyObject *order, int64_t steps)
{
    PyObject *number = steps > 0 ? PyLong_FromLongLong(steps) : NULL;
    PyObject *fractions = number != NULL ? PyObject_CallFunctionObjArgs(order, number, NULL) : NULL;
    Py_XDECREF(number);
    if (fractions != NULL && !(is_plain(fractions, 1) && PyArray_DIM((PyArrayObject *)fractions, 0) == steps + 1))
        Py_CLEAR(fractions);
    return fractions;
}

/* Check the configurations of a motion, and return how many were checked, as a negative number if there is a collision
   among the last ones. Return 0 if Python's general code has to answer. */
static int64_t looked_at(const Configurations *self, const double *start, const double *end, PyArrayObject *fractions)
{
    int64_t count = PyArray_DIM(fractions, 0);
    char *memory = thread_memory(self->memory + count);
    if (memory == NULL)
        return 0;
    struct check_motion_results results;
    struct check_motion arguments = {
        .start = {start, self->width}, .end = {end, self->width}, .fractions = {PyArray_DATA(fractions), count},
        .pack = self->pack, .problem_handle = self->problem, .out = {memory + self->memory, count},
        .hits = self->hits, .memory = memory,
    };
    if (call_kernel(self->check_motion, &arguments, &results, 1) != 0 || results.verdict == CODE_AMBIGUOUS)
        return 0;
    return results.verdict == CODE_COLLIDING ? -results.total : results.total;
}

/* motion(q0, q1, resolution, order) returns the number of configurations that were checked, with a minus sign if there
   is a collision among the last ones; None if Python's general code has to answer. order(steps) is a Python function
   that returns the fractions of the motion in the order in which they are checked. Exceptions that it raises, such as
   an interrupt, are passed on to the caller. */
static PyObject *configurations_motion(Configurations *self, PyObject *const *given, Py_ssize_t count)
{
    if (count != 4 || !PyFloat_CheckExact(given[2]))
        Py_RETURN_NONE;
    double step = PyFloat_AsDouble(given[2]);
    if (!(step > 0 && step < INFINITY))
        Py_RETURN_NONE;
    const double *start = take_configuration(self, given[0]), *end = take_configuration(self, given[1]);
    if (start == NULL || end == NULL)
        Py_RETURN_NONE;
    PyObject *fractions = fractions_of(given[3], steps_of(given[0], given[1], step));
    /* Read both configurations again, because Python code ran in between and may have changed them. */
    start = take_configuration(self, given[0]);
    end = take_configuration(self, given[1]);
    int64_t found =
        fractions != NULL && start != NULL && end != NULL ? looked_at(self, start, end, (PyArrayObject *)fractions) : 0;
    Py_XDECREF(fractions);
    if (found != 0)
        return PyLong_FromLongLong(found);
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

/* -- the type ------------------------------------------------------------------------------------------------------ */

static PyObject *configurations_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    PyObject *check, *motion, *held;
    PyArrayObject *range, *hits;
    static char *known[] = {
        "check_configurations", "check_motion", "pack", "problem", "memory", "piece_pairs", "range", "hits", "held",
        NULL,
    };
    Configurations *made = new_object(type);
    if (made == NULL ||
        !PyArg_ParseTupleAndKeywords(arguments, names, "OOLLLLO!O!O", known, &check, &motion, &made->pack,
                                     &made->problem, &made->memory, &made->piece_pairs, &PyArray_Type, &range,
                                     &PyArray_Type, &hits, &held)) {
        Py_CLEAR(made);
        return NULL;
    }
    made->check_configurations = function_of(check, CHECK_CONFIGURATIONS_WORDS);
    made->check_motion = function_of(motion, CHECK_MOTION_WORDS);
    int is_usual = is_plain((PyObject *)range, 2) && PyArray_DIM(range, 0) == 2 && PyArray_NDIM(hits) == 1 &&
                   PyArray_TYPE(hits) == NPY_INT64 && PyArray_ISCARRAY(hits);
    if (!is_usual && !PyErr_Occurred())
        PyErr_SetString(PyExc_TypeError, "expected a range of shape (2, dof) of float64, and hits of int64");
    if (!PyErr_Occurred()) {
        made->width = PyArray_DIM(range, 1);
        made->least = PyArray_DATA(range);
        made->most = made->least + made->width;
        made->hits = (Array1){PyArray_DATA(hits), PyArray_DIM(hits, 0)};
        made->holder.held = PyTuple_Pack(5, check, motion, range, hits, held);
    }
    if (made->holder.held == NULL)
        Py_CLEAR(made);
    return (PyObject *)made;
}

static PyMethodDef configurations_methods[] = {
    {"collide", (PyCFunction)(void (*)(void))configurations_collide, METH_O, "collide(q): a bool, or None"},
    {"classify", (PyCFunction)(void (*)(void))configurations_classify, METH_O, "classify(q): a number, or None"},
    FAST_METHOD("motion", configurations_motion, "motion(q0, q1, resolution, order): see `singles.py`"),
    {NULL, NULL, 0, NULL},
};

int add_configurations(PyObject *module)
{
    PyObject *math = PyImport_ImportModule("math");
    dist = math != NULL ? PyObject_GetAttrString(math, "dist") : NULL;
    Py_XDECREF(math);
    return dist == NULL ? -1
                        : add_holder(module, "loewner._native._call.Configurations",
                                     "Queries of one configuration or motion; made by `singles.configurations`.",
                                     sizeof(Configurations), configurations_new, configurations_methods);
}
