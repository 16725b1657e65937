/* OMPL's RRT-Connect whose motions are all proven: ./plan cell.lwn [seed]

   The cell is one that `CollisionChecker.save` wrote, such as python examples/save_cell.py cell.lwn. Plans between two
   random free configurations, shortens the path with OMPL's means, and looks at every motion of the result once more. */

#include <loewner.hpp>

#include <ompl/base/MotionValidator.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>
#include <ompl/util/RandomNumbers.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace ob = ompl::base;
namespace og = ompl::geometric;

/* Memory for the queries of this thread: planners may ask from several. */
static loewner::Workspace &workspace()
{
    thread_local loewner::Workspace own;
    return own;
}

static loewner::Numbers values(const loewner::Checker &checker, const ob::State *state)
{
    return {state->as<ob::RealVectorStateSpace::StateType>()->values, checker.dof()};
}

class Validity : public ob::StateValidityChecker {
public:
    Validity(const ob::SpaceInformationPtr &si, const loewner::Checker &checker) : StateValidityChecker(si), checker_(checker) {}
    bool isValid(const ob::State *state) const override
    {
        return si_->satisfiesBounds(state) &&
               checker_.collide(workspace(), values(checker_, state)) == loewner::Verdict::Free;
    }

private:
    const loewner::Checker &checker_;
};

/* A motion is valid if it is proven free at all of its infinitely many configurations; no resolution is involved. */
class Proof : public ob::MotionValidator {
public:
    Proof(const ob::SpaceInformationPtr &si, const loewner::Checker &checker) : MotionValidator(si), checker_(checker) {}
    bool checkMotion(const ob::State *a, const ob::State *b) const override
    {
        const bool free = is_free(a, b);
        ++(free ? valid_ : invalid_);
        return free;
    }
    /* `last` becomes the end of a first part of the motion that is free; proofs tell a collision, not the first one. */
    bool checkMotion(const ob::State *a, const ob::State *b, std::pair<ob::State *, double> &last) const override
    {
        if (checkMotion(a, b))
            return true;
        ob::State *end = si_->cloneState(a);
        last.second = 0;
        for (double fraction = 0.5; fraction > 1e-3 && last.second == 0; fraction /= 2) {
            si_->getStateSpace()->interpolate(a, b, fraction, end);
            if (is_free(a, end))
                last.second = fraction;
        }
        if (last.first != nullptr)
            si_->copyState(last.first, last.second > 0 ? end : a);
        si_->freeState(end);
        return false;
    }

private:
    bool is_free(const ob::State *a, const ob::State *b) const
    {
        return checker_.is_free(workspace(), values(checker_, a), values(checker_, b));
    }
    const loewner::Checker &checker_;
};

int main(int count, char **arguments)
try {
    const loewner::Checker checker(count > 1 ? arguments[1] : "cell.lwn");
    ompl::RNG::setSeed(count > 2 ? std::strtoul(arguments[2], nullptr, 10) : 1);
    const unsigned dof = static_cast<unsigned>(checker.dof());
    auto space = std::make_shared<ob::RealVectorStateSpace>(dof);
    const auto [lower, upper] = checker.limits();
    ob::RealVectorBounds bounds(dof);
    for (unsigned k = 0; k < dof; ++k) { /* OMPL needs limits, also for joints that turn without end */
        bounds.setLow(k, std::isfinite(lower[k]) ? lower[k] : -M_PI);
        bounds.setHigh(k, std::isfinite(upper[k]) ? upper[k] : M_PI);
    }
    space->setBounds(bounds);

    og::SimpleSetup setup(space);
    const auto &information = setup.getSpaceInformation();
    setup.setStateValidityChecker(std::make_shared<Validity>(information, checker));
    information->setMotionValidator(std::make_shared<Proof>(information, checker));
    setup.setPlanner(std::make_shared<og::RRTConnect>(information));
    ob::ScopedState<> start(space), goal(space);
    for (auto *end : {&start, &goal})
        do
            end->random();
        while (!information->isValid(end->get()));
    setup.setStartAndGoalStates(start, goal);
    if (setup.solve(10.0) != ob::PlannerStatus::EXACT_SOLUTION)
        throw std::runtime_error("no path in ten seconds");
    setup.simplifySolution();

    const auto &states = setup.getSolutionPath().getStates();
    std::size_t proven = 0;
    for (std::size_t k = 1; k < states.size(); ++k)
        proven += information->checkMotion(states[k - 1], states[k]);
    std::printf("a path of %.2f rad, %zu of its %zu motions proven free\n", setup.getSolutionPath().length(), proven,
                states.size() - 1);
    return proven == states.size() - 1 ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
