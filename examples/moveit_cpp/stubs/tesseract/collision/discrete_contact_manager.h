// Stand-in for Tesseract's header of this name.
#pragma once

#include <tesseract/collision/types.h>

namespace tesseract::collision {
class DiscreteContactManager {
public:
    using UPtr = std::unique_ptr<DiscreteContactManager>;
    using Id = tesseract::common::LinkId;
    using Ids = std::vector<Id>;
    using IdSet = std::unordered_set<Id>;
    using Poses = tesseract::common::VectorIsometry3d;
    using PoseMap = tesseract::common::LinkIdTransformMap;
    using Validator = std::shared_ptr<const tesseract::common::ContactAllowedValidator>;
    virtual ~DiscreteContactManager() = default;
    virtual std::string getName() const = 0;
    virtual UPtr clone() const = 0;
    virtual bool addCollisionObject(const Id &, const int &, const CollisionShapesConst &, const Poses &, bool = true) = 0;
    virtual const CollisionShapesConst &getCollisionObjectGeometries(const Id &) const = 0;
    virtual const Poses &getCollisionObjectGeometriesTransforms(const Id &) const = 0;
    virtual bool hasCollisionObject(const Id &) const = 0;
    virtual bool removeCollisionObject(const Id &) = 0;
    virtual bool enableCollisionObject(const Id &) = 0;
    virtual bool disableCollisionObject(const Id &) = 0;
    virtual bool isCollisionObjectEnabled(const Id &) const = 0;
    virtual void setCollisionObjectsTransform(const Id &, const Eigen::Isometry3d &) = 0;
    virtual Eigen::Isometry3d getCollisionObjectsTransform(const Id &) const = 0;
    virtual void setCollisionObjectsTransform(const PoseMap &) = 0;
    virtual const Ids &getCollisionObjects() const = 0;
    virtual void setActiveCollisionObjects(const IdSet &) = 0;
    virtual const IdSet &getActiveCollisionObjects() const = 0;
    virtual void setCollisionMarginData(CollisionMarginData) = 0;
    virtual const CollisionMarginData &getCollisionMarginData() const = 0;
    virtual void setCollisionMarginPairData(const CollisionMarginPairData &, CollisionMarginPairOverrideType) = 0;
    virtual void setDefaultCollisionMargin(double) = 0;
    virtual void setCollisionMarginPair(const Id &, const Id &, double) = 0;
    virtual void incrementCollisionMargin(double) = 0;
    virtual void setContactAllowedValidator(Validator) = 0;
    virtual Validator getContactAllowedValidator() const = 0;
    virtual void contactTest(ContactResultMap &, const ContactRequest &) = 0;
};
} // namespace tesseract::collision
