/* A skeleton of MoveIt 2's collision environment on loewner; README.md says what is missing. */

#pragma once

#include "part.hpp"

#include <cstdlib>
#include <mutex>
#include <set>

namespace loewner_moveit {

class CollisionEnvLoewner : public CollisionEnv {
public:
    CollisionEnvLoewner(const RobotModelConstPtr &model, double padding = 0, double scale = 1)
        : CollisionEnv(model, padding, scale)
    {
        begin(padding, scale);
    }
    CollisionEnvLoewner(const RobotModelConstPtr &model, const WorldPtr &world, double padding = 0, double scale = 1)
        : CollisionEnv(model, world, padding, scale)
    {
        begin(padding, scale);
    }
    CollisionEnvLoewner(const CollisionEnvLoewner &it, const WorldPtr &world) : CollisionEnv(it, world) { watch(); }
    ~CollisionEnvLoewner() override { getWorld()->removeObserver(observer_); }

    using Request = CollisionRequest;
    using Result = CollisionResult;
    using Matrix = AllowedCollisionMatrix;
    void checkSelfCollision(const Request &request, Result &result, const RobotState &at) const override
    { look(self_, request, result, at, nullptr, nullptr); }
    void checkSelfCollision(const Request &request, Result &result, const RobotState &at,
                            const Matrix &acm) const override
    { look(self_, request, result, at, nullptr, &acm); }
    void checkRobotCollision(const Request &request, Result &result, const RobotState &at) const override
    { look(robot_, request, result, at, nullptr, nullptr); }
    void checkRobotCollision(const Request &request, Result &result, const RobotState &at,
                             const Matrix &acm) const override
    { look(robot_, request, result, at, nullptr, &acm); }
    /* Between two states: no collision means that the whole motion is proven free, not that samples of it are. */
    void checkRobotCollision(const Request &request, Result &result, const RobotState &from, const RobotState &to,
                             const Matrix &acm) const override { look(robot_, request, result, from, &to, &acm); }
    void checkRobotCollision(const Request &request, Result &result, const RobotState &from,
                             const RobotState &to) const override { look(robot_, request, result, from, &to, nullptr); }
    void distanceSelf(const DistanceRequest &request, DistanceResult &result, const RobotState &at) const override
    { measure(self_, request, result, at); }
    void distanceRobot(const DistanceRequest &request, DistanceResult &result, const RobotState &at) const override
    { measure(robot_, request, result, at); }
    void setWorld(const WorldPtr &world) override
    {
        getWorld()->removeObserver(observer_);
        CollisionEnv::setWorld(world);
        watch();
    }

private:
    void begin(double padding, double scale)
    {
        if (padding != 0 || scale != 1)
            throw std::invalid_argument("loewner: expected no padding and no scale; save the cell with margins");
        watch();
    }
    static std::string cell() /* a plugin would read a parameter */
    {
        const char *path = std::getenv("LOEWNER_CELL");
        return path == nullptr ? "cell.lwn" : path;
    }
    void watch() /* the world says which bodies of the file are there, and where */
    {
        unknown_.clear();
        for (std::int32_t body = 0; body < static_cast<std::int32_t>(robot_.checker.body_count()); ++body)
            if (robot_.in_world(body))
                robot_.checker.set_present(body, false);
        observer_ = getWorld()->addObserver([this](const auto &object, auto action) { change(*object, action); });
        getWorld()->notifyObserverAllObjects(observer_, World::CREATE);
    }
    void change(const World::Object &object, int action)
    {
        const std::lock_guard<std::mutex> only(mutex_);
        const std::int32_t body = loewner_checker_find_body(robot_.checker.get(), object.id_.c_str());
        const bool present = (action & World::DESTROY) == 0;
        unknown_.erase(object.id_);
        if (body >= 0) {
            robot_.checker.set_present(body, present);
            robot_.checker.move(body, rows(object.pose_));
        } else if (present) /* its shape is not in the file, so nothing can be proven while it is there */
            unknown_.insert(object.id_);
    }
    void look(Part &part, const Request &request, Result &result, const RobotState &from, const RobotState *to,
              const Matrix *acm) const
    {
        const std::lock_guard<std::mutex> only(mutex_);
        part.follow(acm);
        const auto q = part.values(from);
        const auto found = to != nullptr ? part.checker.certify_edge(workspace_, q, part.values(*to))
                                         : loewner::Motion{part.checker.collide(workspace_, q), 0, {-1, -1}};
        const bool free = found.verdict == loewner::Verdict::Free; /* what is ambiguous is not */
        if (!free || (&part == &robot_ && !unknown_.empty()))
            result.collision = true; /* and never false: MoveIt asks several times with one result */
        if (request.contacts && !free)
            describe(part, q, found, to == nullptr, result);
    }
    void describe(const Part &part, const std::vector<double> &q, loewner::Motion found, bool here,
                  Result &result) const
    {
        Contact contact;
        contact.percent_interpolation = found.fraction;
        if (here) {
            const auto deepest = part.checker.distance(workspace_, q);
            found.bodies = {deepest.bodies[0], deepest.bodies[1]};
            contact.depth = -deepest.distance;
            contact.pos = vector(deepest.witness_a);
            contact.normal = vector(deepest.normal);
        }
        if (found.bodies[0] < 0)
            return;
        contact.body_name_1 = part.checker.body_name(found.bodies[0]);
        contact.body_name_2 = part.checker.body_name(found.bodies[1]);
        result.contacts[{contact.body_name_1, contact.body_name_2}].push_back(contact);
        ++result.contact_count;
    }
    void measure(Part &part, const DistanceRequest &request, DistanceResult &result, const RobotState &at) const
    {
        const std::lock_guard<std::mutex> only(mutex_);
        part.follow(request.acm);
        if (part.checker.pair_count() == 0)
            return;
        const auto found = part.checker.distance(workspace_, part.values(at));
        auto &nearest = result.minimum_distance;
        nearest.distance = std::isnan(found.distance) ? found.lower : found.distance;
        result.collision = nearest.distance <= 0;
        nearest.normal = vector(found.normal);
        nearest.nearest_points[0] = vector(found.witness_a);
        nearest.nearest_points[1] = vector(found.witness_b);
        for (int k = 0; k < 2; ++k)
            nearest.link_names[k] = part.checker.body_name(found.bodies[k]);
    }

    mutable std::mutex mutex_;
    mutable Part self_{cell(), true}, robot_{cell(), false};
    mutable loewner::Workspace workspace_;
    World::ObserverHandle observer_{};
    std::set<std::string> unknown_;
};

} // namespace loewner_moveit
