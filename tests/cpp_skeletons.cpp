/* The skeletons of examples/moveit_cpp, run: cpp_skeletons CELL < NUMBERS

   NUMBERS are how many bodies there are in the scene, their names and poses, and configurations. Prints a line for each
   configuration but the last, 1 for a collision: MoveIt's self-collision, its collision with the world, the same on the
   motion to the next configuration, and with all pairs allowed; Tesseract's at the configuration, and on the motion. */

#include "collision_env_loewner.hpp"
#include "discrete_and_continuous.hpp"

#include <cstdio>
#include <iostream>

using tesseract::common::LinkId;

static Eigen::Isometry3d isometry(const double *rows)
{
    Eigen::Isometry3d found;
    for (int k = 0; k < 16; ++k)
        found(k / 4, k % 4) = rows[k];
    return found;
}

template <class... States> static int hit(const loewner_moveit::CollisionEnvLoewner &env, const States &...states)
{
    collision_detection::CollisionRequest request;
    collision_detection::CollisionResult result;
    request.contacts = true;
    env.checkRobotCollision(request, result, states...);
    return result.collision;
}

struct All : tesseract::common::ContactAllowedValidator {
    bool operator()(const tesseract::common::LinkIdPair &) const override { return true; }
};

int main(int, char **words)
{
    const loewner::Checker checker(words[1]);
    auto world = std::make_shared<collision_detection::World>();
    const loewner_moveit::CollisionEnvLoewner empty(nullptr, world);
    loewner_tesseract::DiscreteManager discrete(words[1]);
    loewner_tesseract::ContinuousManager continuous(words[1]);
    std::size_t count;
    std::string name;
    std::vector<double> numbers(16);
    for (std::cin >> count; count > 0; --count) {
        std::cin >> name;
        for (double &value : numbers)
            std::cin >> value;
        world->put(name, isometry(numbers.data()));
        discrete.setCollisionObjectsTransform(LinkId(name), isometry(numbers.data()));
        continuous.setCollisionObjectsTransform(LinkId(name), isometry(numbers.data()));
    }
    const loewner_moveit::CollisionEnvLoewner env(empty, world);
    collision_detection::AllowedCollisionMatrix acm;
    for (std::int32_t a = 0; a < static_cast<std::int32_t>(checker.body_count()); ++a)
        for (std::int32_t b = 0; b < static_cast<std::int32_t>(checker.body_count()); ++b)
            acm.entries[{checker.body_name(a), checker.body_name(b)}] = collision_detection::AllowedCollision::ALWAYS;

    std::vector<std::vector<double>> Q;
    for (double value; std::cin >> value; Q.back().push_back(value))
        if (Q.empty() || Q.back().size() == checker.dof())
            Q.emplace_back();
    const auto state = [&](const std::vector<double> &q) {
        moveit::core::RobotState made;
        for (std::size_t k = 0; k < q.size(); ++k)
            made.variables[checker.value_name(static_cast<std::int32_t>(k))] = q[k];
        return made;
    };
    std::vector<double> poses(16 * checker.link_count());
    auto copy = continuous.clone();
    auto &moved = static_cast<loewner_tesseract::ContinuousManager &>(*copy);
    for (std::size_t k = 0; k + 1 < Q.size(); ++k) {
        const auto one = state(Q[k]), two = state(Q[k + 1]);
        collision_detection::CollisionResult self;
        env.checkSelfCollision({}, self, one);
        loewner::expect(loewner_checker_link_poses(checker.get(), Q[k].data(), 1, poses.data()));
        for (std::size_t link = 0; link < checker.link_count(); ++link)
            discrete.setCollisionObjectsTransform(LinkId(checker.link_name(static_cast<std::int32_t>(link))),
                                                  isometry(&poses[16 * link]));
        tesseract::collision::ContactResultMap here, between;
        discrete.contactTest(here, {});
        moved.set_motion(Q[k], Q[k + 1]);
        moved.contactTest(between, {});
        std::printf("%d %d %d %d %d %d\n", self.collision, hit(env, one), hit(env, one, two), hit(env, one, two, acm),
                    here.size() > 0, between.size() > 0);
    }
    moved.setContactAllowedValidator(std::make_shared<All>());
    tesseract::collision::ContactResultMap none;
    moved.contactTest(none, {});
    world->put("unheard of", {});
    std::printf("%d %d\n", none.size() > 0, hit(env, state(Q[0]), acm));
    return 0;
}
