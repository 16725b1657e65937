// Stand-in for the parts of Tesseract that the skeleton uses: signatures, and as little behind them as a test needs.
#pragma once

#include <Eigen/Geometry>

#include <array>
#include <functional>
#include <initializer_list>
#include <map>
#include <memory>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

namespace tesseract::geometry {
class Geometry;
}

namespace tesseract::common {
class LinkId {
public:
    LinkId() = default;
    explicit LinkId(std::string name) : name_(std::move(name)) {}
    const std::string &name() const { return name_; }
    friend bool operator==(const LinkId &a, const LinkId &b) { return a.name_ == b.name_; }

private:
    std::string name_;
};
class LinkIdPair {
public:
    LinkIdPair(LinkId a, LinkId b) : first_(std::move(a)), second_(std::move(b)) {}
    const LinkId &first() const { return first_; }
    const LinkId &second() const { return second_; }

private:
    LinkId first_, second_;
};
} // namespace tesseract::common
template <> struct std::hash<tesseract::common::LinkId> {
    std::size_t operator()(const tesseract::common::LinkId &id) const { return std::hash<std::string>()(id.name()); }
};

namespace tesseract::common {
using VectorIsometry3d = std::vector<Eigen::Isometry3d>;
using LinkIdTransformMap = std::unordered_map<LinkId, Eigen::Isometry3d>;
class ContactAllowedValidator;
enum class CollisionMarginPairOverrideType { NONE, REPLACE, MODIFY };
class CollisionMarginPairData {};
class CollisionMarginData {
public:
    explicit CollisionMarginData(double margin = 0) : margin_(margin) {}
    void apply(const CollisionMarginPairData &, CollisionMarginPairOverrideType) {}
    void setDefaultCollisionMargin(double margin) { margin_ = margin; }
    void setCollisionMargin(const LinkId &, const LinkId &, double) {}
    void incrementMargins(double increment) { margin_ += increment; }
    double getCollisionMargin(const LinkId &, const LinkId &) const { return margin_; }

private:
    double margin_;
};
} // namespace tesseract::common

namespace tesseract::collision {
using CollisionShapesConst = std::vector<std::shared_ptr<const tesseract::geometry::Geometry>>;
using tesseract::common::CollisionMarginData;
using tesseract::common::CollisionMarginPairData;
using tesseract::common::CollisionMarginPairOverrideType;
enum class ContinuousCollisionType { CCType_None, CCType_Time0, CCType_Time1, CCType_Between };
enum class ContactTestType { FIRST, CLOSEST, ALL, LIMITED };
struct ContactRequest {
    ContactTestType type = ContactTestType::ALL;
};
struct ContactResult {
    double distance = 0;
    std::array<tesseract::common::LinkId, 2> link_ids;
    std::array<double, 2> cc_time{-1, -1};
    std::array<ContinuousCollisionType, 2> cc_type{};
};
class ContactResultMap {
public:
    ContactResult &addContactResult(const tesseract::common::LinkIdPair &key, ContactResult result)
    {
        return held_[{key.first().name(), key.second().name()}] = std::move(result);
    }
    std::size_t size() const { return held_.size(); }

private:
    std::map<std::pair<std::string, std::string>, ContactResult> held_;
};
struct ContactManagerConfig {};
} // namespace tesseract::collision
