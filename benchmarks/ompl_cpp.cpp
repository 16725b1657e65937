// OMPL's RRT-Connect in C++ with three checkers of motions, one after the other on each problem:
//
//   proven     MotionValidator on loewner's is_free
//   sampled    OMPL's DiscreteMotionValidator at a resolution of FRACTION, with loewner's exact collide
//   fcl        the same with FCL: a dynamic AABB tree for the scene, boxes and then shapes for pairs of links
//
//   ompl_cpp agree FOLDER PROBLEM...      FCL's verdicts beside ours, at those of PROBLEM.configurations
//   ompl_cpp plan FOLDER SHAPES SEEDS ROUNDS LIMIT FRACTION PROBLEM...
//
// ompl_cpp.py writes the folder, compiles this file and reads the lines that it prints. FCL gets the link poses that
// loewner computes, so that both have the same kinematics; its own would take about as long, a small part of its time.

#include <loewner.hpp>

#include <fcl/fcl.h>
#include <ompl/base/MotionValidator.h>
#include <ompl/base/goals/GoalStates.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/PathGeometric.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>
#include <ompl/util/Console.h>
#include <ompl/util/RandomNumbers.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

namespace ob = ompl::base;
namespace og = ompl::geometric;

namespace {

// What ompl_cpp.py wrote about a problem, beside the checker itself.
struct Problem {
    loewner::Checker checker;
    std::vector<std::size_t> columns; // of the values that are planned
    std::vector<double> start;        // of all values
    std::vector<std::vector<double>> goals;

    struct Shape {
        std::int32_t body;
        std::string kind;            // box, cylinder, sphere, hull
        std::vector<double> numbers; // sizes, or coordinates of vertices
        std::vector<int> triangles; // three vertices each
        loewner::Pose pose; // in the world, of a body of the scene
    };
    std::vector<Shape> shapes;

    explicit Problem(const std::string &path) : checker(path + ".lwn")
    {
        std::ifstream in(path + ".txt");
        const auto values = [&in](auto &to, std::size_t count) {
            to.resize(count);
            for (auto &value : to)
                in >> value;
        };
        std::size_t planned, goal_count, shape_count, numbers, triangles;
        in >> planned >> goal_count >> shape_count;
        values(columns, planned);
        values(start, checker.dof());
        goals.resize(goal_count);
        for (auto &goal : goals)
            values(goal, checker.dof());
        shapes.resize(shape_count);
        for (auto &shape : shapes) {
            std::string name;
            std::getline(in >> std::ws, name);
            shape.body = checker.body(name);
            in >> shape.kind >> numbers >> triangles;
            values(shape.numbers, numbers);
            values(shape.triangles, 3 * triangles);
            for (double &value : shape.pose)
                in >> value;
        }
        if (!in)
            throw std::runtime_error("ompl_cpp: cannot read " + path + ".txt");
    }
};

fcl::Transform3d transform(const double *pose)
{
    fcl::Transform3d found = fcl::Transform3d::Identity();
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 4; ++column)
            found(row, column) = pose[4 * row + column];
    return found;
}

std::shared_ptr<fcl::CollisionGeometryd> geometry(const Problem::Shape &shape, bool mesh)
{
    const auto &n = shape.numbers;
    if (shape.kind == "box")
        return std::make_shared<fcl::Boxd>(n[0], n[1], n[2]);
    if (shape.kind == "cylinder")
        return std::make_shared<fcl::Cylinderd>(n[0], n[1]);
    if (shape.kind == "sphere")
        return std::make_shared<fcl::Sphered>(n[0]);
    auto vertices = std::make_shared<std::vector<fcl::Vector3d>>();
    for (std::size_t k = 0; k < n.size(); k += 3)
        vertices->emplace_back(n[k], n[k + 1], n[k + 2]);
    if (!mesh) {
        auto faces = std::make_shared<std::vector<int>>();
        for (std::size_t k = 0; k < shape.triangles.size(); ++k) {
            if (k % 3 == 0)
                faces->push_back(3);
            faces->push_back(shape.triangles[k]);
        }
        return std::make_shared<fcl::Convexd>(vertices, static_cast<int>(shape.triangles.size() / 3), faces);
    }
    std::vector<fcl::Triangle> triangles;
    for (std::size_t k = 0; k < shape.triangles.size(); k += 3)
        triangles.emplace_back(shape.triangles[k], shape.triangles[k + 1], shape.triangles[k + 2]);
    auto made = std::make_shared<fcl::BVHModel<fcl::OBBRSSd>>();
    made->beginModel();
    made->addSubModel(*vertices, triangles);
    made->endModel();
    return made;
}

// FCL, told the shapes and the pairs of the checker.
class Fcl {
public:
    // `way` is "convex" (libccd), "convex-indep" (FCL's own GJK) or "mesh" (hulls as trees of triangles).
    Fcl(const Problem &problem, const std::string &way)
        : checker_(problem.checker), poses_(16 * checker_.link_count()), count_(checker_.body_count()),
          checked_(count_ * count_, 0)
    {
        request_.gjk_solver_type = way == "convex-indep" ? fcl::GST_INDEP : fcl::GST_LIBCCD;
        for (std::int64_t k = 0; k < loewner_checker_pair_count(checker_.get()); ++k) {
            std::int32_t pair[2];
            loewner::expect(loewner_checker_pair(checker_.get(), k, pair));
            checked_[static_cast<std::size_t>(pair[0]) * count_ + static_cast<std::size_t>(pair[1])] = 1;
            checked_[static_cast<std::size_t>(pair[1]) * count_ + static_cast<std::size_t>(pair[0])] = 1;
        }
        for (const auto &shape : problem.shapes) {
            const std::string name = checker_.body_name(shape.body);
            const auto pose = transform(shape.pose.data());
            auto held = std::make_unique<fcl::CollisionObjectd>(geometry(shape, way == "mesh"), pose);
            held->computeAABB();
            objects_.push_back({static_cast<std::size_t>(shape.body),
                                loewner_checker_find_link(checker_.get(), name.c_str()), std::move(held)});
        }
        for (auto &object : objects_) {
            object.held->setUserData(&object);
            if (object.link < 0)
                scene_.registerObject(object.held.get());
            else
                robot_.push_back(&object);
        }
        scene_.setup();
        for (std::size_t i = 0; i < robot_.size(); ++i)
            for (std::size_t j = 0; j < i; ++j)
                if (checked(*robot_[i], *robot_[j]))
                    pairs_.emplace_back(robot_[i], robot_[j]);
    }
    Fcl(const Fcl &) = delete;

    bool collides(const double *q)
    {
        loewner::expect(loewner_checker_link_poses(checker_.get(), q, 1, poses_.data()));
        for (Object *object : robot_) {
            object->held->setTransform(transform(&poses_[16 * static_cast<std::size_t>(object->link)]));
            object->held->computeAABB();
        }
        hit_ = false;
        for (Object *object : robot_) {
            scene_.collide(object->held.get(), this, &Fcl::meet);
            if (hit_)
                return true;
        }
        for (const auto &[a, b] : pairs_)
            if (a->held->getAABB().overlap(b->held->getAABB()) && touch(*a, *b))
                return true;
        return false;
    }

private:
    struct Object {
        std::size_t body;
        std::int32_t link; // -1 in the scene
        std::unique_ptr<fcl::CollisionObjectd> held;
    };

    bool checked(const Object &a, const Object &b) const { return checked_[a.body * count_ + b.body] != 0; }
    bool touch(const Object &a, const Object &b)
    {
        fcl::CollisionResultd result;
        return fcl::collide(a.held.get(), b.held.get(), request_, result) > 0;
    }
    static bool meet(fcl::CollisionObjectd *one, fcl::CollisionObjectd *other, void *data)
    {
        auto *self = static_cast<Fcl *>(data);
        const auto &a = *static_cast<Object *>(one->getUserData()), &b = *static_cast<Object *>(other->getUserData());
        self->hit_ = self->hit_ || (self->checked(a, b) && self->touch(a, b));
        return self->hit_;
    }

    const loewner::Checker &checker_;
    std::vector<double> poses_;
    std::size_t count_;
    std::vector<char> checked_;
    std::vector<Object> objects_;
    std::vector<Object *> robot_;
    std::vector<std::pair<Object *, Object *>> pairs_;
    fcl::DynamicAABBTreeCollisionManagerd scene_;
    fcl::CollisionRequestd request_{1, false};
    bool hit_ = false;
};

double cpu_seconds()
{
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// -- OMPL ---------------------------------------------------------------------------------------------------------

// All values of a configuration of which OMPL knows a part.
class Whole {
public:
    explicit Whole(const Problem &problem) : columns_(problem.columns), q_(problem.start) {}
    const std::vector<double> &operator()(const ob::State *state)
    {
        const auto &values = *state->as<ob::RealVectorStateSpace::StateType>();
        for (std::size_t k = 0; k < columns_.size(); ++k)
            q_[columns_[k]] = values[static_cast<unsigned>(k)];
        return q_;
    }

private:
    const std::vector<std::size_t> &columns_;
    std::vector<double> q_;
};

class Proven : public ob::MotionValidator {
public:
    Proven(const ob::SpaceInformationPtr &information, const Problem &problem, loewner::Workspace &workspace)
        : MotionValidator(information), checker_(problem.checker), workspace_(workspace), start_(problem), end_(problem)
    {
    }
    bool checkMotion(const ob::State *a, const ob::State *b) const override
    {
        const bool free = checker_.is_free(workspace_, start_(a), end_(b));
        ++(free ? valid_ : invalid_);
        return free;
    }
    bool checkMotion(const ob::State *a, const ob::State *b, std::pair<ob::State *, double> &last) const override
    {
        last.second = 0; // RRT-Connect does not ask how far a motion is free
        return checkMotion(a, b);
    }

private:
    const loewner::Checker &checker_;
    loewner::Workspace &workspace_;
    mutable Whole start_, end_;
};

struct Run {
    bool solved;
    double seconds;
    unsigned motions;
    std::size_t states; // the validity checker's calls
    std::vector<double> path;
};

Run plan(const Problem &problem, const std::string &name, loewner::Workspace &workspace, Fcl &fcl,
         int seed, double limit, double fraction)
{
    const std::size_t width = problem.columns.size();
    auto space = std::make_shared<ob::RealVectorStateSpace>(static_cast<unsigned>(width));
    const auto limits = problem.checker.limits();
    ob::RealVectorBounds bounds(static_cast<unsigned>(width));
    for (std::size_t k = 0; k < width; ++k) {
        bounds.low[k] = limits.first[problem.columns[k]];
        bounds.high[k] = limits.second[problem.columns[k]];
    }
    space->setBounds(bounds);
    auto information = std::make_shared<ob::SpaceInformation>(space);
    Whole whole(problem);
    Run run{};
    if (name == "proven") { // a proof holds at both ends too, and every state of a tree is the end of a motion
        information->setStateValidityChecker([&run](const ob::State *) { return ++run.states > 0; });
        information->setMotionValidator(std::make_shared<Proven>(information, problem, workspace));
    } else if (name == "sampled")
        information->setStateValidityChecker([&](const ob::State *state) {
            ++run.states;
            return problem.checker.collide(workspace, whole(state)) == loewner::Verdict::Free;
        });
    else
        information->setStateValidityChecker([&](const ob::State *state) {
            ++run.states;
            return !fcl.collides(whole(state).data());
        });
    information->setStateValidityCheckingResolution(fraction);
    information->setup();

    auto definition = std::make_shared<ob::ProblemDefinition>(information);
    auto goals = std::make_shared<ob::GoalStates>(information);
    ob::ScopedState<ob::RealVectorStateSpace> state(space);
    const auto part = [&](const std::vector<double> &q) -> const ob::ScopedState<ob::RealVectorStateSpace> & {
        for (std::size_t k = 0; k < width; ++k)
            state[static_cast<unsigned>(k)] = q[problem.columns[k]];
        return state;
    };
    definition->addStartState(part(problem.start));
    for (const auto &goal : problem.goals)
        goals->addState(part(goal));
    definition->setGoal(goals);
    ompl::RNG::setSeed(static_cast<std::uint_fast32_t>(seed));
    og::RRTConnect planner(information);
    planner.setProblemDefinition(definition);
    planner.setup();

    const double began = cpu_seconds();
    planner.solve(ob::timedPlannerTerminationCondition(limit));
    run.seconds = cpu_seconds() - began;
    run.solved = definition->hasExactSolution();
    run.motions = information->getMotionValidator()->getValidMotionCount() +
                  information->getMotionValidator()->getInvalidMotionCount();
    if (run.solved)
        for (const auto *each : definition->getSolutionPath()->as<og::PathGeometric>()->getStates())
            run.path.insert(run.path.end(), whole(each).begin(), whole(each).end());
    return run;
}

int plans(const std::string &folder, int count, char **words)
{
    const std::string shapes = words[0];
    const int seeds = std::atoi(words[1]), rounds = std::atoi(words[2]);
    const double limit = std::atof(words[3]), fraction = std::atof(words[4]);
    loewner::Workspace workspace;
    for (int k = 5; k < count; ++k) {
        const Problem problem(folder + "/" + words[k]);
        Fcl fcl(problem, shapes);
        for (int seed = 1; seed <= seeds; ++seed) {
            std::vector<std::pair<std::string, Run>> runs{{"proven", {}}, {"sampled", {}}, {"fcl", {}}};
            for (int round = 0; round < rounds; ++round)
                for (auto &[name, kept] : runs) {
                    Run run = plan(problem, name, workspace, fcl, seed, limit, fraction);
                    run.seconds = round == 0 ? run.seconds : std::min(run.seconds, kept.seconds);
                    kept = std::move(run);
                }
            for (const auto &[name, run] : runs) {
                std::printf("%s %s %d %d %.9g", words[k], name.c_str(), seed, run.solved, run.seconds);
                std::printf(" %u %zu", run.motions, run.states);
                for (double value : run.path)
                    std::printf(" %.17g", value);
                std::printf("\n");
            }
            std::fflush(stdout);
        }
    }
    return 0;
}

// -- verdicts -----------------------------------------------------------------------------------------------------

// One line for each way of FCL's and for us: problem, way, seconds for a configuration, verdicts as digits.
int agree(const std::string &folder, int count, char **names)
{
    for (int k = 0; k < count; ++k) {
        const std::string path = folder + "/" + names[k];
        const Problem problem(path);
        std::ifstream in(path + ".configurations");
        std::vector<double> Q;
        for (double value; in >> value;)
            Q.push_back(value);
        const std::size_t dof = problem.checker.dof(), n = Q.size() / dof;
        for (const char *way : {"loewner", "convex", "convex-indep", "mesh"}) {
            const bool ours = std::string(way) == "loewner";
            Fcl fcl(problem, way);
            loewner::Workspace workspace;
            std::string found;
            const double began = cpu_seconds();
            for (std::size_t i = 0; i < n; ++i) {
                const loewner::Numbers q(&Q[dof * i], dof);
                found += ours ? problem.checker.collide(workspace, q) != loewner::Verdict::Free ? '1' : '0'
                         : fcl.collides(q.data())                                               ? '1'
                                                                                                : '0';
            }
            const double each = (cpu_seconds() - began) / static_cast<double>(n);
            std::printf("%s %s %.9g %s\n", names[k], way, each, found.c_str());
        }
    }
    return 0;
}

} // namespace

int main(int count, char **words)
{
    ompl::msg::setLogLevel(ompl::msg::LOG_NONE);
    try {
        const std::string task = count > 3 ? words[1] : "";
        if (task == "agree")
            return agree(words[2], count - 3, words + 3);
        if (task == "plan" && count > 8)
            return plans(words[2], count - 3, words + 3);
        throw std::runtime_error("ompl_cpp: expected agree FOLDER PROBLEM..., or plan and what ompl_cpp.py passes");
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
