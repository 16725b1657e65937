/* The two contact managers themselves: link poses, and motions between joint values. */

#pragma once

#include "contact_managers_loewner.hpp"

#include <optional>
#include <stdexcept>

namespace loewner_tesseract {

class DiscreteManager : public Manager<DiscreteContactManager> {
public:
    using Manager::Manager;
    DiscreteContactManager::UPtr clone() const override { return copy<DiscreteManager>(); }
    void contactTest(ContactResultMap &collisions, const ContactRequest &request) override
    {
        std::vector<double> poses;
        for (std::int32_t link = 0; link < static_cast<std::int32_t>(checker_.link_count()); ++link) {
            const auto pose = rows(poses_.at(LinkId(checker_.link_name(link))));
            poses.insert(poses.end(), pose.begin(), pose.end());
        }
        const auto now = pairs();
        std::vector<std::int8_t> verdicts(now.size());
        std::int8_t all;
        loewner::expect(
            loewner_checker_collide_placed(checker_.get(), workspace_.get(), poses.data(), &all, verdicts.data()));
        for (std::size_t k = 0; k < now.size(); ++k) {
            if (verdicts[k] != LOEWNER_FREE)
                report(collisions, now[k][0], now[k][1], -1);
            if (request.type == ContactTestType::FIRST && collisions.size() > 0)
                return;
        }
    }
};

/* Two poses of each link do not say what happens between them, so `set_motion` takes the joint values, from a caller
   who knows that this is loewner's manager. What is then reported holds for the motion of the joints: not for a hull
   of two poses, which turning links leave. */
class ContinuousManager : public Manager<ContinuousContactManager> {
public:
    using Manager::Manager;
    ContinuousContactManager::UPtr clone() const override { return copy<ContinuousManager>(); }
    using Manager::setCollisionObjectsTransform;
    void setCollisionObjectsTransform(const LinkId &id, const Eigen::Isometry3d &,
                                      const Eigen::Isometry3d &end) override
    {
        motion_.reset();
        setCollisionObjectsTransform(id, end);
    }
    void setCollisionObjectsTransform(const LinkIdTransformMap &, const LinkIdTransformMap &ends) override
    {
        motion_.reset();
        setCollisionObjectsTransform(ends);
    }
    void set_motion(std::vector<double> start, std::vector<double> end)
    {
        motion_ = {std::move(start), std::move(end)};
    }
    void contactTest(ContactResultMap &collisions, const ContactRequest &) override
    {
        if (!motion_)
            throw std::logic_error("loewner: expected set_motion with joint values after the poses were set");
        const auto found = checker_.certify_edge(workspace_, motion_->first, motion_->second);
        if (found.verdict != loewner::Verdict::Free)
            report(collisions, found.bodies[0], found.bodies[1], found.fraction);
    }

private:
    std::optional<std::pair<std::vector<double>, std::vector<double>>> motion_;
};

} // namespace loewner_tesseract
