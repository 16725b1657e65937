// Stand-in for the parts of MoveIt 2 that the skeleton uses: signatures, and as little behind them as a test needs.
#pragma once

#include <Eigen/Geometry>

#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace moveit::core {
struct RobotModel {};
using RobotModelConstPtr = std::shared_ptr<const RobotModel>;
struct RobotState {
    std::map<std::string, double> variables;
    double getVariablePosition(const std::string &variable) const { return variables.at(variable); }
};
} // namespace moveit::core

namespace collision_detection {
namespace AllowedCollision {
enum Type { NEVER, ALWAYS, CONDITIONAL };
}
struct AllowedCollisionMatrix {
    std::map<std::pair<std::string, std::string>, AllowedCollision::Type> entries;
    bool getAllowedCollision(const std::string &name1, const std::string &name2, AllowedCollision::Type &allowed) const
    {
        const auto found = entries.find({name1, name2});
        if (found == entries.end())
            return false;
        allowed = found->second;
        return true;
    }
};

struct Contact {
    Eigen::Vector3d pos, normal, nearest_points[2];
    double depth = 0, percent_interpolation = 0;
    std::string body_name_1, body_name_2;
};
struct CollisionRequest {
    bool contacts = false;
};
struct CollisionResult {
    bool collision = false;
    std::size_t contact_count = 0;
    std::map<std::pair<std::string, std::string>, std::vector<Contact>> contacts;
};
struct DistanceRequest {
    const AllowedCollisionMatrix *acm = nullptr;
};
struct DistanceResultsData {
    double distance = std::numeric_limits<double>::max();
    Eigen::Vector3d nearest_points[2], normal;
    std::string link_names[2];
};
struct DistanceResult {
    bool collision = false;
    DistanceResultsData minimum_distance;
};

struct World {
    struct Object {
        std::string id_;
        Eigen::Isometry3d pose_;
    };
    using ObjectConstPtr = std::shared_ptr<const Object>;
    enum ActionBits { UNINITIALIZED = 0, CREATE = 1, DESTROY = 2, MOVE_SHAPE = 4, ADD_SHAPE = 8, REMOVE_SHAPE = 16 };
    using Action = int;
    using ObserverHandle = std::size_t;
    using ObserverCallbackFn = std::function<void(const ObjectConstPtr &, Action)>;

    ObserverHandle addObserver(const ObserverCallbackFn &callback)
    {
        observers_[++last_] = callback;
        return last_;
    }
    void removeObserver(ObserverHandle handle) { observers_.erase(handle); }
    void notifyObserverAllObjects(ObserverHandle handle, Action action) const
    {
        for (const auto &object : objects_)
            observers_.at(handle)(object.second, action);
    }
    void put(const std::string &id, const Eigen::Isometry3d &pose) // MoveIt's own functions take shapes, too
    {
        objects_[id] = std::make_shared<Object>(Object{id, pose});
        for (const auto &observer : observers_)
            observer.second(objects_[id], CREATE | ADD_SHAPE);
    }

private:
    std::map<std::string, ObjectConstPtr> objects_;
    std::map<ObserverHandle, ObserverCallbackFn> observers_;
    ObserverHandle last_ = 0;
};
using WorldPtr = std::shared_ptr<World>;

class CollisionEnv {
public:
    using State = moveit::core::RobotState;
    CollisionEnv(const moveit::core::RobotModelConstPtr &model, double, double) : model_(model), world_(std::make_shared<World>()) {}
    CollisionEnv(const moveit::core::RobotModelConstPtr &model, const WorldPtr &world, double, double) : model_(model), world_(world) {}
    CollisionEnv(const CollisionEnv &other, const WorldPtr &world) : model_(other.model_), world_(world) {}
    virtual ~CollisionEnv() = default;
    virtual void checkSelfCollision(const CollisionRequest &, CollisionResult &, const State &) const = 0;
    virtual void checkSelfCollision(const CollisionRequest &, CollisionResult &, const State &, const AllowedCollisionMatrix &) const = 0;
    virtual void checkRobotCollision(const CollisionRequest &, CollisionResult &, const State &) const = 0;
    virtual void checkRobotCollision(const CollisionRequest &, CollisionResult &, const State &, const AllowedCollisionMatrix &) const = 0;
    virtual void checkRobotCollision(const CollisionRequest &, CollisionResult &, const State &, const State &, const AllowedCollisionMatrix &) const = 0;
    virtual void checkRobotCollision(const CollisionRequest &, CollisionResult &, const State &, const State &) const = 0;
    virtual void distanceSelf(const DistanceRequest &, DistanceResult &, const State &) const = 0;
    virtual void distanceRobot(const DistanceRequest &, DistanceResult &, const State &) const = 0;
    virtual void setWorld(const WorldPtr &world) { world_ = world; }
    const WorldPtr &getWorld() { return world_; }

private:
    moveit::core::RobotModelConstPtr model_;
    WorldPtr world_;
};
} // namespace collision_detection
