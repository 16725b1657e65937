/* What collision_env_loewner.hpp asks: a checker for one kind of pairs, and conversions. */

#pragma once

#include <loewner.hpp>
#include <moveit/collision_detection/collision_env.hpp>

namespace loewner_moveit {

using namespace collision_detection;
using moveit::core::RobotModelConstPtr;
using moveit::core::RobotState;

inline Eigen::Vector3d vector(const double (&numbers)[3]) { return {numbers[0], numbers[1], numbers[2]}; }
inline loewner::Pose rows(const Eigen::Isometry3d &pose)
{
    loewner::Pose found;
    for (int k = 0; k < 16; ++k)
        found[static_cast<std::size_t>(k)] = pose(k / 4, k % 4);
    return found;
}

/* MoveIt asks about the robot with itself and with the world separately: a checker for each, of the same file. */
struct Part {
    loewner::Checker checker;
    std::vector<std::array<std::int32_t, 2>> pairs;
    std::vector<bool> allowed;

    Part(const std::string &cell, bool self) : checker(cell)
    {
        std::vector<std::array<std::int32_t, 2>> every(checker.pair_count());
        for (std::size_t k = 0; k < every.size(); ++k)
            loewner::expect(loewner_checker_pair(checker.get(), static_cast<std::int64_t>(k), every[k].data()));
        for (const auto &pair : every)
            if ((in_world(pair[0]) || in_world(pair[1])) != self)
                pairs.push_back(pair);
            else
                checker.allow(pair[0], pair[1]);
        allowed.assign(pairs.size(), false);
    }
    std::vector<double> values(const RobotState &state) const
    {
        std::vector<double> q;
        for (std::size_t k = 0; k < checker.dof(); ++k)
            q.push_back(state.getVariablePosition(checker.value_name(static_cast<std::int32_t>(k))));
        return q;
    }
    bool in_world(std::int32_t body) const
    {
        return loewner_checker_find_link(checker.get(), checker.body_name(body).c_str()) < 0;
    }
    /* Allow what MoveIt's matrix allows now. */
    void follow(const AllowedCollisionMatrix *acm)
    {
        for (std::size_t k = 0; k < pairs.size(); ++k) {
            AllowedCollision::Type type = AllowedCollision::NEVER;
            const std::string a = checker.body_name(pairs[k][0]), b = checker.body_name(pairs[k][1]);
            const bool now = acm != nullptr && acm->getAllowedCollision(a, b, type) && type == AllowedCollision::ALWAYS;
            if (now != allowed[k])
                checker.allow(pairs[k][0], pairs[k][1], now);
            allowed[k] = now;
        }
    }
};

} // namespace loewner_moveit
