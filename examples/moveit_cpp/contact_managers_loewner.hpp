/* A skeleton of Tesseract's contact managers on loewner; README.md says what is missing. */

#pragma once

#include <loewner.hpp>
#include <tesseract/collision/continuous_contact_manager.h>
#include <tesseract/collision/discrete_contact_manager.h>
#include <tesseract/common/contact_allowed_validator.h>

namespace loewner_tesseract {

using namespace tesseract::collision;
using tesseract::common::LinkId;
using tesseract::common::LinkIdPair;
using tesseract::common::LinkIdTransformMap;
using tesseract::common::VectorIsometry3d;
using Validator = std::shared_ptr<const tesseract::common::ContactAllowedValidator>;

using Pair = std::array<std::int32_t, 2>;

inline loewner::Pose rows(const Eigen::Isometry3d &pose)
{
    loewner::Pose found;
    for (int k = 0; k < 16; ++k)
        found[static_cast<std::size_t>(k)] = pose(k / 4, k % 4);
    return found;
}

/* What both managers share. Links, bodies of the scene and their shapes are those of a file that Python saved. */
template <class Interface> class Manager : public Interface {
public:
    explicit Manager(const std::string &cell) : cell_(cell), checker_(cell)
    {
        for (std::int32_t k = 0; k < static_cast<std::int32_t>(checker_.body_count()); ++k)
            ids_.emplace_back(checker_.body_name(k));
        pairs_ = pairs();
    }
    std::string getName() const override { return "loewner"; }
    bool addCollisionObject(const LinkId &id, const int &, const CollisionShapesConst &, const VectorIsometry3d &,
                            bool enabled = true) override
    { return enabled ? enableCollisionObject(id) : disableCollisionObject(id); }
    const CollisionShapesConst &getCollisionObjectGeometries(const LinkId &) const override { return no_shapes_; }
    const VectorIsometry3d &getCollisionObjectGeometriesTransforms(const LinkId &) const override { return no_poses_; }
    bool hasCollisionObject(const LinkId &id) const override { return body(id) >= 0; }
    bool removeCollisionObject(const LinkId &id) override { return disableCollisionObject(id); }
    bool enableCollisionObject(const LinkId &id) override { return show(id, true); }
    bool disableCollisionObject(const LinkId &id) override { return show(id, false); }
    bool isCollisionObjectEnabled(const LinkId &id) const override { return body(id) >= 0 && hidden_.count(id) == 0; }
    void setCollisionObjectsTransform(const LinkId &id, const Eigen::Isometry3d &pose) override
    {
        poses_[id] = pose;
        const bool is_link = loewner_checker_find_link(checker_.get(), id.name().c_str()) >= 0;
        if (!is_link && body(id) >= 0)
            checker_.move(body(id), rows(pose));
    }
    void setCollisionObjectsTransform(const LinkIdTransformMap &poses) override
    {
        for (const auto &each : poses)
            setCollisionObjectsTransform(each.first, each.second);
    }
    Eigen::Isometry3d getCollisionObjectsTransform(const LinkId &id) const override { return poses_.at(id); }
    const std::vector<LinkId> &getCollisionObjects() const override { return ids_; }
    void setActiveCollisionObjects(const std::unordered_set<LinkId> &ids) override { active_ = ids; }
    const std::unordered_set<LinkId> &getActiveCollisionObjects() const override { return active_; }
    void setCollisionMarginData(CollisionMarginData margins) override
    {
        margins_ = margins;
        for (const auto &[a, b] : pairs_)
            checker_.set_margin(a, b, margins_.getCollisionMargin(id(a), id(b)));
    }
    const CollisionMarginData &getCollisionMarginData() const override { return margins_; }
    void setCollisionMarginPairData(const CollisionMarginPairData &pairs, CollisionMarginPairOverrideType type) override
    { change_margins([&](auto &margins) { margins.apply(pairs, type); }); }
    void setDefaultCollisionMargin(double margin) override
    { change_margins([&](auto &margins) { margins.setDefaultCollisionMargin(margin); }); }
    void setCollisionMarginPair(const LinkId &a, const LinkId &b, double margin) override
    { change_margins([&](auto &margins) { margins.setCollisionMargin(a, b, margin); }); }
    void incrementCollisionMargin(double more) override
    { change_margins([&](auto &margins) { margins.incrementMargins(more); }); }
    void setContactAllowedValidator(Validator validator) override
    {
        validator_ = std::move(validator);
        for (const auto &[a, b] : pairs_)
            checker_.allow(a, b, validator_ != nullptr && (*validator_)(LinkIdPair(id(a), id(b))));
    }
    Validator getContactAllowedValidator() const override { return validator_; }

protected:
    template <class Made> typename Interface::UPtr copy() const
    {
        auto made = std::make_unique<Made>(cell_);
        made->setCollisionMarginData(margins_);
        made->setContactAllowedValidator(validator_);
        made->setCollisionObjectsTransform(poses_);
        made->setActiveCollisionObjects(active_);
        for (const LinkId &each : hidden_)
            made->disableCollisionObject(each);
        return made;
    }
    std::int32_t body(const LinkId &id) const { return loewner_checker_find_body(checker_.get(), id.name().c_str()); }
    LinkId id(std::int32_t body) const { return body < 0 ? LinkId() : ids_[static_cast<std::size_t>(body)]; }
    std::vector<Pair> pairs() const
    {
        std::vector<Pair> found(checker_.pair_count());
        for (std::size_t k = 0; k < found.size(); ++k)
            loewner::expect(loewner_checker_pair(checker_.get(), static_cast<std::int64_t>(k), found[k].data()));
        return found;
    }
    /* Report a pair that is not proven free; a distance of 0 stands for contact. */
    void report(ContactResultMap &collisions, std::int32_t a, std::int32_t b, double time) const
    {
        ContactResult result;
        result.distance = 0;
        result.link_ids = {id(a), id(b)};
        result.cc_time = {time, time};
        collisions.addContactResult(LinkIdPair(id(a), id(b)), result);
    }

    std::string cell_;
    loewner::Checker checker_;
    loewner::Workspace workspace_;
    LinkIdTransformMap poses_;
    Validator validator_;

private:
    template <class Change> void change_margins(Change change)
    {
        CollisionMarginData margins = margins_;
        change(margins);
        setCollisionMarginData(margins);
    }
    bool show(const LinkId &id, bool present)
    {
        if (body(id) < 0)
            return false;
        checker_.set_present(body(id), present);
        hidden_.erase(id);
        if (!present)
            hidden_.insert(id);
        return true;
    }
    CollisionMarginData margins_;
    std::vector<LinkId> ids_;
    std::vector<Pair> pairs_; /* of the file */
    std::unordered_set<LinkId> active_, hidden_;
    CollisionShapesConst no_shapes_;
    VectorIsometry3d no_poses_;
};

} // namespace loewner_tesseract
