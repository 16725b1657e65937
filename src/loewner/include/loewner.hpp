/* loewner.hpp: `loewner.h` for C++17, with owners that close their objects, and vectors and views instead of pointers.

   All functions here are inline, and thus part of the calling program; the library itself throws no exceptions. A
   status other than OK becomes a `loewner::Error`. The rules of `loewner.h` for units, shapes, ownership and threads
   also apply here. */

#ifndef LOEWNER_HPP
#define LOEWNER_HPP

#include "loewner.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace loewner
{

class Error : public std::runtime_error
{
public:
    Error(loewner_status status, const std::string &text) : std::runtime_error(text), status_(status) {}
    loewner_status status() const noexcept { return status_; }

private:
    loewner_status status_;
};

inline void expect(loewner_status status)
{
    if (status != LOEWNER_OK)
        throw Error(status, loewner_error_text());
}

namespace detail
{

template <auto leave> struct Leave {
    template <class T> void operator()(T *held) const noexcept { leave(held); }
};

/* The owner of an object of the library; `leave` is the function that closes the object. */
template <class T, auto leave> using Held = std::unique_ptr<T, Leave<leave>>;

/* Call a function that makes an object, and return the object, which the function writes to its last argument. */
template <class T, class Make, class... Arguments> T *make(Make function, Arguments... arguments)
{
    T *made = nullptr;
    expect(function(arguments..., &made));
    return made;
}

} // namespace detail

enum class Verdict : std::int8_t { Free = LOEWNER_FREE, Colliding = LOEWNER_COLLIDING, Ambiguous = LOEWNER_AMBIGUOUS };

/* A view of numbers that it does not own, from a vector, an array, or a pointer and a length. */
template <class T> class View
{
public:
    View() = default;
    View(T *data, std::size_t size) : data_(data), size_(size) {}
    template <class Container, class = decltype(std::declval<Container &>().data())> View(Container &&container)
        : data_(container.data()), size_(container.size())
    {
    }
    T *data() const noexcept { return data_; }
    std::size_t size() const noexcept { return size_; }
    T *begin() const noexcept { return data_; }
    T *end() const noexcept { return data_ + size_; }
    T &operator[](std::size_t k) const { return data_[k]; }

private:
    T *data_ = nullptr;
    std::size_t size_ = 0;
};

using Numbers = View<const double>;
using Pose = std::array<double, 16>; /* a 4x4 matrix in row order */

/* Memory for the queries of one thread at a time. */
class Workspace
{
public:
    Workspace() : held_(detail::make<loewner_workspace>(loewner_workspace_new)) {}
    loewner_workspace *get() const noexcept { return held_.get(); }

private:
    detail::Held<loewner_workspace, loewner_workspace_free> held_;
};

/* The bodies in a file that `Body.save` or `Bodies.save` wrote. */
class Bodies
{
public:
    explicit Bodies(const std::string &path) : held_(detail::make<loewner_bodies>(loewner_bodies_open, path.c_str())) {}
    std::size_t size() const noexcept { return static_cast<std::size_t>(loewner_bodies_count(held_.get())); }
    const loewner_bodies *get() const noexcept { return held_.get(); }

private:
    detail::Held<loewner_bodies, loewner_bodies_close> held_;
};

struct Motion {
    Verdict verdict;
    double fraction;                    /* NaN for Free */
    std::array<std::int32_t, 2> bodies; /* -1 for none */
    std::int64_t steps = 0;             /* steps that the proof took */
};

/* A robot in a scene, from a file that `CollisionChecker.save` wrote. */
class Checker
{
public:
    explicit Checker(const std::string &path)
        : held_(detail::make<loewner_checker>(loewner_checker_open, path.c_str()))
    {
    }

    std::size_t dof() const noexcept { return static_cast<std::size_t>(loewner_checker_dof(get())); }
    std::vector<double> link_poses(Numbers q) const
    {
        std::vector<double> poses(16 * link_count());
        expect_rows(q, 1);
        expect(loewner_checker_link_poses(get(), q.data(), 1, poses.data()));
        return poses;
    }
    std::size_t link_count() const noexcept { return static_cast<std::size_t>(loewner_checker_link_count(get())); }
    std::size_t body_count() const noexcept { return static_cast<std::size_t>(loewner_checker_body_count(get())); }
    std::size_t pair_count() const noexcept { return static_cast<std::size_t>(loewner_checker_pair_count(get())); }
    std::int32_t link(const std::string &name) const
    {
        return known(loewner_checker_find_link(get(), name.c_str()), name);
    }
    std::int32_t body(const std::string &name) const
    {
        return known(loewner_checker_find_body(get(), name.c_str()), name);
    }
    std::string body_name(std::int32_t body) const { return text(loewner_checker_body_name(get(), body)); }
    std::string link_name(std::int32_t link) const { return text(loewner_checker_link_name(get(), link)); }
    std::string value_name(std::int32_t value) const { return text(loewner_checker_value_name(get(), value)); }

    /* The lower and the upper limits of the values. */
    std::pair<std::vector<double>, std::vector<double>> limits() const
    {
        std::vector<double> lower(dof()), upper(dof());
        expect(loewner_checker_limits(get(), lower.data(), upper.data()));
        return {std::move(lower), std::move(upper)};
    }

    /* The verdict for one configuration. */
    Verdict classify(Workspace &workspace, Numbers q) const
    {
        return verdict_of(loewner_checker_classify, workspace, q);
    }
    Verdict collide(Workspace &workspace, Numbers q) const { return verdict_of(loewner_checker_collide, workspace, q); }

    /* The verdicts for configurations that are stored one after another. */
    void collide(Workspace &workspace, Numbers configurations, View<std::int8_t> verdicts) const
    {
        expect_rows(configurations, verdicts.size());
        expect(
            loewner_checker_collide(get(), workspace.get(), configurations.data(), verdicts.size(), verdicts.data()));
    }
    Verdict collide_placed(Workspace &workspace, Numbers link_poses) const
    {
        std::int8_t found = LOEWNER_AMBIGUOUS;
        if (link_poses.size() != 16 * link_count())
            throw Error(LOEWNER_BAD_ARGUMENT, "link_poses: expected 16 numbers for each link");
        expect(loewner_checker_collide_placed(get(), workspace.get(), link_poses.data(), &found, nullptr));
        return static_cast<Verdict>(found);
    }

    /* The nearest pair at one configuration and, on request, the gradient of its distance. */
    loewner_distance distance(Workspace &workspace, Numbers q, View<double> gradient = {}) const
    {
        loewner_distance found;
        expect_rows(q, 1);
        expect_gradient(gradient);
        expect(loewner_checker_distance(get(), workspace.get(), q.data(), 1, &found, gradient.data()));
        return found;
    }
    double clearance(Workspace &workspace, Numbers q, double softness = 0.005, View<double> gradient = {}) const
    {
        double found = 0;
        expect_rows(q, 1);
        expect_gradient(gradient);
        expect(loewner_checker_clearance(get(), workspace.get(), q.data(), 1, softness, &found, gradient.data()));
        return found;
    }

    /* Prove one straight motion; `steps` limits the work, as described in loewner.h. `times` has two entries, the times
       at which the motion begins and ends [s], for bodies with bounds that grow. */
    Motion certify_edge(Workspace &workspace, Numbers start, Numbers end, double tolerance = 1e-5,
                        Numbers joint_error = {}, std::int64_t steps = 0, Numbers times = {}) const
    {
        std::int64_t taken = 0;
        std::int8_t found = LOEWNER_AMBIGUOUS;
        std::int32_t bodies[1][2] = {{-1, -1}};
        double fraction = NAN;
        if (times.size() != 0 && times.size() != 2)
            throw Error(LOEWNER_BAD_ARGUMENT, "times: expected two, found " + std::to_string(times.size()));
        loewner_proof_options options = options_of(tolerance, joint_error, steps);
        options.steps_taken = &taken;
        if (times.size() == 2) {
            options.t0 = times.data();
            options.t1 = times.data() + 1;
        }
        expect_rows(start, 1);
        expect_rows(end, 1);
        expect(loewner_checker_certify_edges(get(), workspace.get(), start.data(), end.data(), 1, &options, &found,
                                             &fraction, bodies));
        return {static_cast<Verdict>(found), fraction, {bodies[0][0], bodies[0][1]}, taken};
    }

    /* Whether one straight motion is proven free, for a planner's motion validator. */
    bool is_free(Workspace &workspace, Numbers start, Numbers end, double tolerance = 1e-5, Numbers joint_error = {},
                 std::int64_t steps = 0) const
    {
        std::int8_t found = 0;
        const loewner_proof_options options = options_of(tolerance, joint_error, steps);
        expect_rows(start, 1);
        expect_rows(end, 1);
        expect(loewner_checker_motions_free(get(), workspace.get(), start.data(), end.data(), 1, &options, &found));
        return found == 1;
    }

    /* Prove motions; their starts are stored one after another, as are their ends. */
    void certify_edges(Workspace &workspace, Numbers starts, Numbers ends, View<std::int8_t> verdicts,
                       double tolerance = 1e-5, std::int64_t steps = 0) const
    {
        const loewner_proof_options options = options_of(tolerance, {}, steps);
        expect_rows(starts, verdicts.size());
        expect_rows(ends, verdicts.size());
        expect(loewner_checker_certify_edges(get(), workspace.get(), starts.data(), ends.data(), verdicts.size(),
                                             &options, verdicts.data(), nullptr, nullptr));
    }

    /* A path from a configuration to one of several goals, as rows of a flat vector. */
    std::vector<double> plan(Workspace &workspace, Numbers start, Numbers goals,
                             const loewner_plan_options &options = {}) const
    {
        const double *path = nullptr;
        std::size_t count = 0;
        const std::size_t rows = rows_of(goals);
        expect_rows(start, 1);
        expect(loewner_checker_plan(get(), workspace.get(), start.data(), goals.data(), rows, &options, &path, &count));
        return std::vector<double>(path, path + count * dof());
    }
    std::vector<double> shorten(Workspace &workspace, Numbers path, const loewner_plan_options &options = {}) const
    {
        const double *shorter = nullptr;
        std::size_t count = 0;
        expect(loewner_checker_shorten(get(), workspace.get(), path.data(), rows_of(path), &options, &shorter, &count));
        return std::vector<double>(shorter, shorter + count * dof());
    }

    void move(std::int32_t body, const Pose &pose) { expect(loewner_checker_move(held_.get(), &body, pose.data(), 1)); }
    std::int32_t add(const std::string &name, const Bodies &bodies, std::int64_t which, const Pose &pose)
    {
        std::int32_t made = -1;
        expect(loewner_checker_add(held_.get(), name.c_str(), bodies.get(), which, pose.data(), &made));
        return made;
    }
    void set_present(std::int32_t body, bool present)
    {
        expect(loewner_checker_set_present(held_.get(), body, present));
    }
    void attach(std::int32_t body, std::int32_t link, const Pose &pose_in_link,
                View<const std::int32_t> touch_links = {})
    {
        expect(loewner_checker_attach(held_.get(), body, link, pose_in_link.data(), touch_links.data(),
                                      touch_links.size()));
    }
    void attach(std::int32_t body, std::int32_t link, const Pose &pose_in_link,
                std::initializer_list<std::int32_t> touch_links)
    {
        attach(body, link, pose_in_link, View<const std::int32_t>(touch_links.begin(), touch_links.size()));
    }
    void detach(std::int32_t body, const Pose &pose) { expect(loewner_checker_detach(held_.get(), body, pose.data())); }
    void allow(std::int32_t a, std::int32_t b, bool allowed = true)
    {
        expect(loewner_checker_allow(held_.get(), a, b, allowed));
    }
    void set_margin(std::int32_t a, std::int32_t b, double margin)
    {
        expect(loewner_checker_set_margin(held_.get(), a, b, margin));
    }
    void set_bounds(std::int32_t body, const loewner_bounds &bounds)
    {
        expect(loewner_checker_set_bounds(held_.get(), body, &bounds));
    }
    void end_bounds(std::int32_t body) { expect(loewner_checker_set_bounds(held_.get(), body, nullptr)); }

    /* The checker for the other functions of `loewner.h`. */
    const loewner_checker *get() const noexcept { return held_.get(); }
    loewner_checker *get() noexcept { return held_.get(); }

private:
    template <class Query> Verdict verdict_of(Query query, Workspace &workspace, Numbers q) const
    {
        std::int8_t found = LOEWNER_AMBIGUOUS;
        expect_rows(q, 1);
        expect(query(get(), workspace.get(), q.data(), 1, &found));
        return static_cast<Verdict>(found);
    }
    loewner_proof_options options_of(double tolerance, Numbers joint_error, std::int64_t steps) const
    {
        if (joint_error.size() != 0)
            expect_rows(joint_error, 1);
        return {tolerance, joint_error.size() == 0 ? nullptr : joint_error.data(), nullptr, nullptr, steps, nullptr};
    }
    static std::string text(const char *name)
    {
        if (name == nullptr)
            throw Error(LOEWNER_BAD_ARGUMENT, "expected a number with a name, found another");
        return name;
    }
    static std::int32_t known(std::int32_t number, const std::string &name)
    {
        if (number < 0)
            throw Error(LOEWNER_UNKNOWN_NAME, "expected a name of the file, found " + name);
        return number;
    }
    void expect_rows(Numbers numbers, std::size_t rows) const
    {
        if (numbers.size() != rows * dof())
            throw Error(LOEWNER_BAD_ARGUMENT, "expected " + std::to_string(rows * dof()) + " numbers, found " +
                                                  std::to_string(numbers.size()));
    }
    std::size_t rows_of(Numbers numbers) const
    {
        const std::size_t width = dof();
        if (width == 0 || numbers.size() % width != 0)
            throw Error(LOEWNER_BAD_ARGUMENT, "expected whole configurations of " + std::to_string(width) +
                                                  " numbers, found " + std::to_string(numbers.size()));
        return numbers.size() / width;
    }
    void expect_gradient(View<double> gradient) const
    {
        if (gradient.size() != 0 && gradient.size() != dof())
            throw Error(LOEWNER_BAD_ARGUMENT, "gradient: expected room for a configuration");
    }

    detail::Held<loewner_checker, loewner_checker_close> held_;
};

/* Chunks of targets in a control loop. The checker must live longer than its gates. */
class Gate
{
public:
    Gate(const Checker &checker, const loewner_gate_options &options, std::size_t most_targets)
        : dof_(checker.dof()),
          held_(detail::make<loewner_gate>(loewner_gate_new, checker.get(), &options, most_targets))
    {
    }

    /* The brake in the answer is valid until the next check. */
    loewner_gate_answer check(Numbers q, Numbers dq, Numbers targets, double dt, double time = 0)
    {
        loewner_gate_answer found;
        if (q.size() != dof_ || dq.size() != dof_ || targets.size() % dof_ != 0)
            throw Error(LOEWNER_BAD_ARGUMENT,
                        "q, dq, targets: expected " + std::to_string(dof_) + ", " + std::to_string(dof_) +
                            " and a multiple of " + std::to_string(dof_) + " numbers, found " +
                            std::to_string(q.size()) + ", " + std::to_string(dq.size()) + " and " +
                            std::to_string(targets.size()));
        expect(loewner_gate_check(held_.get(), q.data(), dq.data(), targets.data(), targets.size() / dof_, dt, time,
                                  &found));
        return found;
    }

    loewner_gate *get() noexcept { return held_.get(); }

private:
    std::size_t dof_;
    detail::Held<loewner_gate, loewner_gate_free> held_;
};

} // namespace loewner

#endif
